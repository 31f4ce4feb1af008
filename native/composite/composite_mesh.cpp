#include "composite/composite_mesh.hpp"

#include <algorithm>
#include <set>

namespace amrpic {

namespace {

/// The electrode of all surfaces in the equation of a cut cell; -1 if there are several, or walls among them.
int only_electrode(CutCell const& cut, CutRow const& row) {
  int out = -1;
  for (std::size_t side = 0; side < 6; ++side) {
    if (!row.has_surface(side)) continue;
    if (!cut.is_cut(side) || (out >= 0 && out != cut.electrode[side])) return -1;
    out = cut.electrode[side];
  }
  return out;
}

}  // namespace

CompositeMesh::CompositeMesh(std::shared_ptr<Hierarchy const> hierarchy, Real shift, Real3 const& stretch,
                             Metal const* metal)
    : hierarchy_(std::move(hierarchy)),
      shift_(shift),
      stretch_(stretch),
      plan_(*hierarchy_, metal ? plane_reach : 0),
      transfer_(hierarchy_),
      conductors_(metal),
      metal_(std::size_t(levels())) {
  for (int l = levels() - 1; metal && l >= 0; --l) {  // so that the coarser ones know of the finer
    add_metal(l);
    if (l > 0) add_metal_faces(l);
    has_metal_faces_ = has_metal_faces_ || !plan(l).gaps.empty();  // whose fits may take cells in metal
    if (hierarchy_->has_finer(l)) add_refined_sides(l);
    place_metal(l);
  }
  if (metal) has_metal_faces_ = comm().any(has_metal_faces_);
  for_each_box([&](int l, int b) {
    for (int d = 0; d < 3; ++d) {
      auto const [u, v] = tangential_axes(d);
      std::size_t const face = std::size_t(box(l, b).extent(u)) * std::size_t(box(l, b).extent(v));
      largest_face_[d] = std::max(largest_face_[d], face);
      largest_row_ = std::max(largest_row_, std::size_t(box(l, b).extent(d)));
    }
  });
}

void CompositeMesh::add_metal(int l) {
  OfLevel& of_level = metal_[std::size_t(l)];
  std::vector<Box> own;
  for (int b = 0; b < boxes(l); ++b) own.push_back(box(l, b));
  std::vector<Level const*> finer;
  if (hierarchy_->has_finer(l)) finer.push_back(&level(l + 1));
  of_level.cells = metal_of_level(*conductors_, level(l), l > 0 ? &level(l - 1) : nullptr, finer, own, false);
}

CutRow CompositeMesh::row_of(int l, CutCell const& cut) const {
  std::array<Arm, 6> arms;
  for (std::size_t n = 0; n < 6; ++n) {
    int const axis = int(n) / 2, side = int(n) % 2;
    Box const& domain = level(l).domain();
    bool const wall = !level(l).periodic()[axis] && cut.cell[axis] == (side == 0 ? domain.lower : domain.upper)[axis];
    arms[n] = arm_of(cut, n);
    arms[n].is_parabola = wall && hierarchy_->domain().boundary[axis][side] == Boundary::dirichlet;
  }
  return cut_row(equation(l), arms);
}

void CompositeMesh::add_metal_faces(int l) {
  auto& faces = metal_[std::size_t(l)].faces;
  faces.resize(plan(l).interfaces.size());
  std::vector<Box> own, behind;
  for (int b = 0; b < boxes(l); ++b)
    own.push_back(box(l, b).grow(1)), behind.push_back(box(l, b).coarsen(refinement_ratio).grow(1 + plane_reach));
  LevelsInMetal const levels(level(l - 1), level(l), conductors_->cells(level(l - 1), behind),
                             conductors_->cells(level(l), own));
  for (int b = 0; b < boxes(l); ++b)
    for (int f = 0; f < 6; ++f) {
      int const number = plan(l, b).faces[std::size_t(f)].interface;
      if (number < 0) continue;
      Interface const& i = plan(l).interfaces[std::size_t(number)];
      FitNumber const* fit = &plan(l).fits[std::size_t(i.fits)];
      auto const [u, v] = tangential_axes(f / 2);
      Index3 const first = box(l, b).coarsen(refinement_ratio).layer(f / 2, f % 2, 1).lower;
      for (int y = 0; y < i.nv; ++y)
        for (int x = 0; x < i.nu; ++x, ++fit) {
          if (*fit == no_fit) continue;
          Index3 cell = first;
          cell[u] += i.u + x, cell[v] += i.v + y;
          if (auto face = levels.beside_metal({cell, f / 2, f % 2}, *fit))
            faces[std::size_t(number)].push_back(std::move(*face));
        }
      has_metal_faces_ = has_metal_faces_ || !faces[std::size_t(number)].empty();
    }
}

void CompositeMesh::add_refined_sides(int l) {
  OfLevel& of_level = metal_[std::size_t(l)];
  std::set<GlobalIndex> shared;
  Box const& domain = level(l).domain();
  for (SharedFace const& face : of_level.cells.shared) shared.insert(domain.offset(face.cell));
  if (metal(l).empty() && shared.empty()) return;
  for (int b = 0; b < boxes(l); ++b)
    for (int s = plan(l, b).refined.first; s < plan(l, b).refined.last; ++s) {
      RefinedSide const& side = plan(l).refined[std::size_t(s)];
      for_each_cell(side.cells.shift(box(l, b).lower), [&](Index3 const& cell) {
        GlobalIndex const number = domain.offset(cell);
        if (metal(l).cut_at(cell) || shared.count(number)) of_level.refined[{number, 2 * side.axis + side.side}] = s;
      });
    }
}

void CompositeMesh::place_metal(int l) {
  OfLevel& of = metal_[std::size_t(l)];
  std::vector<char> covered;  // of a plane
  auto const end = [&] { return std::array{std::int32_t(of.cuts.size()), std::int32_t(of.solids.size())}; };
  for (int b = 0; b < boxes(l); ++b) {
    of.first_plane.push_back(std::int32_t(of.planes.size()));
    for (int k = 0; k < box(l, b).extent(2); ++k) {
      covered.assign(std::size_t(box(l, b).stride(2)), 0);
      for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) { std::fill_n(&covered[std::size_t(at)], n, 1); });
      auto const first = end();
      place_metal(l, b, k, covered, 0);
      auto const between = end();
      if (!plan(l, b).covered.empty()) place_metal(l, b, k, covered, 1);
      of.planes.push_back({first[0], between[0], first[1], between[1]});
    }
  }
  of.planes.push_back({end()[0], end()[0], end()[1], end()[1]});
}

/// Those cells in plane k of a box that are covered or not.
void CompositeMesh::place_metal(int l, int b, int k, std::vector<char> const& covered, char which) {
  OfLevel& of = metal_[std::size_t(l)];
  MetalCells const& cells = metal(l);
  Box const& own = box(l, b);
  std::size_t const first_run = of.solids.size();
  for (int j = 0; j < own.extent(1); ++j) {
    Index3 const first{own.lower[0], own.lower[1] + j, own.lower[2] + k};
    auto const place = [&](Index3 const& cell) { return cell[0] - first[0] + j * own.extent(0); };
    cells.for_each_cut(first, own.extent(0), [&](CutCell const& cut) {
      std::int32_t const at = place(cut.cell);
      if (covered[std::size_t(at)] != which) return;
      CutInPlane out{row_of(l, cut), cut.cell, at, std::int32_t(&cut - cells.cut().data())};
      out.electrode = only_electrode(cut, out.row);
      for (int side = 0; side < 6; ++side) {
        Index3 next = cut.cell;
        next[side / 2] += side % 2 == 0 ? -1 : 1;
        if (own.contains(next) && !finer_beyond(l, cut.cell, side)) out.inside |= std::uint8_t(1 << side);
      }
      of.cuts.push_back(out);
    });
    cells.for_each_solid(first, own.extent(0), [&](SolidCell const& solid) {
      std::int32_t const at = place(solid.cell);
      if (covered[std::size_t(at)] != which) return;
      bool const goes_on = of.solids.size() > first_run && of.solids.back().electrode == solid.electrode &&
                           of.solids.back().place + of.solids.back().count == at;
      goes_on ? void(++of.solids.back().count) : of.solids.push_back({at, 1, solid.electrode});
    });
  }
}

bool CompositeMesh::has_metal(int l, int b) const {
  OfLevel const& of = metal_[std::size_t(l)];
  if (of.cells.cells.empty()) return false;
  auto const first = of.planes.begin() + of.first_plane[std::size_t(b)], last = first + box(l, b).extent(2);
  return first->first_cut < last->first_cut || first->first_solid < last->first_solid;
}

RefinedSide const* CompositeMesh::finer_beyond(int l, Index3 const& cell, int side) const {
  auto const& refined = metal_[std::size_t(l)].refined;
  if (refined.empty()) return nullptr;
  auto const at = refined.find({level(l).domain().offset(cell), side});
  return at == refined.end() ? nullptr : &plan(l).refined[std::size_t(at->second)];
}

void CompositeMesh::clear_covered(int l, int b, int k, Real* plane) const {
  for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) { std::fill_n(plane + at, n, 0.0); });
}

bool CompositeMesh::is_covered(int l, int b, Index3 const& cell) const {
  Index3 const at = counted_from_first(box(l, b), cell);
  for (int c = plan(l, b).covered.first; c < plan(l, b).covered.last; ++c)
    if (plan(l).covered[std::size_t(c)].contains(at)) return true;
  return false;
}

}  // namespace amrpic
