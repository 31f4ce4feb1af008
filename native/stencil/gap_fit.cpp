#include "stencil/gap_fit.hpp"

#include <algorithm>
#include <iterator>

#include "gmls/problem.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

namespace {

constexpr Real reach = 3;               ///< fine widths
constexpr Real residual_bound = 1e-11;  ///< of reproduction
constexpr Real sum_bound = 10;          ///< of |weights|; where the sites determine a fit it stays below
/// Of the cell behind the face in a quadratic fit: 0.2 and more where cells lie all around. With less the fit goes by
/// differences of others, as in corners of walls, and the flux hardly falls, or rises, with the value of that cell: no
/// cycle reduces such errors.
constexpr Real least_weight = 0.1;

/// The usable cells, coarse ones first, with weights of zero; places in fine widths from the middle of the cube.
struct Sites {
  GapFit fit;
  std::vector<Real> place;  ///< (cells, 3)

  explicit Sites(GapSites const& sites) {
    for (int n = 0; n < 27; ++n)
      if (sites.coarse >> n & 1) add(false, {n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1});
    for (int n = 0; n < 27; ++n)
      for (int c = 0; c < 8; ++c)
        if (sites.children[std::size_t(n)] >> c & 1)
          add(true, {2 * (n % 3 - 1) + c % 2, 2 * (n / 3 % 3 - 1) + c / 2 % 2, 2 * (n / 9 - 1) + c / 4});
  }

 private:
  void add(bool fine, Index3 const& cell) {
    GapFit::Term term{fine, {}, {}};
    for (int d = 0; d < 3; ++d) {
      term.offset[std::size_t(d)] = std::int8_t(cell[d]);
      place.push_back(fine ? cell[d] - 0.5 : 2.0 * cell[d]);
    }
    fit.terms.push_back(term);
  }
};

/// The four problems, one for each fine face.
struct Problems {
  std::vector<Real> target, reaches{reach, reach, reach, reach};
  std::vector<std::int64_t> start{0};
  std::vector<LocalIndex> index;

  Problems(Sites const& sites, int axis) {
    auto const [u, v] = tangential_axes(axis);
    for (int face = 0; face < 4; ++face) {
      Real3 place{0, 0, 0};
      place[std::size_t(u)] = 2 * quarter(face % 2 != 0);
      place[std::size_t(v)] = 2 * quarter(face / 2 != 0);
      target.insert(target.end(), place.begin(), place.end());
      for (std::size_t s = 0; s < sites.fit.terms.size(); ++s) {
        Real square = 0;
        for (std::size_t d = 0; d < 3; ++d)
          square += (sites.place[3 * s + d] - place[d]) * (sites.place[3 * s + d] - place[d]);
        if (square < reach * reach) index.push_back(LocalIndex(s));
      }
      start.push_back(std::int64_t(index.size()));
    }
  }
};

/// The value of the middle cell, with a slope along each axis of the plane from what neighbours there are.
GapFit linear_fit(GapSites const& sites, int axis) {
  GapFit out{{{false, {0, 0, 0}, {{{1, 1}, {1, 1}}}}}};
  auto const [u, v] = tangential_axes(axis);
  for (int d : {u, v}) {
    constexpr int middle = 13;
    int const step = d == 0 ? 1 : d == 1 ? 3 : 9;
    bool const below = sites.coarse >> (middle - step) & 1, above = sites.coarse >> (middle + step) & 1;
    Real const weight = below && above ? 0.5 : 1;  // of a one-sided difference
    for (int side : {-1, 1}) {
      if (!(side < 0 ? below : above)) continue;
      GapFit::Term term{false, {0, 0, 0}, {}};
      term.offset[std::size_t(d)] = std::int8_t(side);
      for (std::size_t b = 0; b < 2; ++b)
        for (std::size_t a = 0; a < 2; ++a) {
          term.weight[b][a] = weight * side * quarter((d == u ? a : b) != 0);
          out.terms.front().weight[b][a] -= term.weight[b][a];
        }
      out.terms.push_back(term);
    }
  }
  return out;
}

bool has_fine_cells(GapSites const& sites) {
  return std::any_of(sites.children.begin(), sites.children.end(), [](auto children) { return children != 0; });
}

/// A fit without the cells that none of its four values takes, and without spare memory: there may be many fits.
GapFit with_weights_alone(GapFit const& fit) {
  auto const counts = [](GapFit::Term const& term) { return term.weight != FourStars<Real>{}; };
  GapFit out;
  out.terms.reserve(std::size_t(std::count_if(fit.terms.begin(), fit.terms.end(), counts)));
  std::copy_if(fit.terms.begin(), fit.terms.end(), std::back_inserter(out.terms), counts);
  return out;
}

}  // namespace

GapFit gap_fit(GapSites const& sites, int axis) {
  if (!has_fine_cells(sites)) return linear_fit(sites, axis);
  Sites all(sites);
  Problems const problems(all, axis);
  Real const one = 1;
  std::array<Real, 3> const here{0, 0, 0};
  std::vector<Real> weight(problems.index.size()), judged(12);
  auto const middle = std::find_if(all.fit.terms.begin(), all.fit.terms.end(), [](GapFit::Term const& term) {
    return !term.fine && term.offset == std::array<std::int8_t, 3>{};
  });
  auto const place = LocalIndex(middle - all.fit.terms.begin());
  std::array<gmls::Path, 4> path;
  std::array<bool, 4> done{};
  for (int order = 2; order >= 0; --order) {
    gmls::Problem problem(3, order);
    problem.weight = {gmls::WeightKind::power, 2, 2};
    problem.count = 4;
    problem.targets = problems.target.data();
    problem.reach = problems.reaches.data();
    problem.start = problems.start.data();
    problem.index = problems.index.data();
    problem.sites = all.place.data();
    problem.wanted = {3, 1, 1, {{0, 0, 0, {0, 0, 0}}}, 1, here.data(), nullptr, &one};
    gmls::solve(problem, residual_bound, sum_bound, false,
                {weight.data(), nullptr, path.data(), judged.data(), judged.data() + 4, judged.data() + 8});
    for (int face = 0; face < 4; ++face) {
      if (done[std::size_t(face)] || path[std::size_t(face)] == gmls::Path::undetermined) continue;
      auto const first = std::size_t(problems.start[std::size_t(face)]);
      auto const k = std::find(problems.index.begin() + std::ptrdiff_t(first), problems.index.end(), place);
      if (order == 2 && weight[std::size_t(k - problems.index.begin())] < least_weight) continue;
      done[std::size_t(face)] = true;
      for (auto k = problems.start[std::size_t(face)]; k < problems.start[std::size_t(face) + 1]; ++k)
        all.fit.terms[std::size_t(problems.index[std::size_t(k)])]
            .weight[std::size_t(face / 2)][std::size_t(face % 2)] = weight[std::size_t(k)];
    }
    if (done[0] && done[1] && done[2] && done[3]) break;
  }
  return with_weights_alone(all.fit);
}

}  // namespace amrpic
