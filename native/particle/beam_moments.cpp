#include "particle/beam_moments.hpp"

#include <limits>

namespace amrpic {

namespace {

constexpr std::size_t n = beam_coordinates;
constexpr std::size_t most_rows = 512, least_rows = 16;  // of a block; the most fit into the first-level cache
constexpr std::size_t rows_of_all = 1u << 16;            // of the blocks of all parts, unless these are too many

/// Sum over the lanes, in their order.
Real sum_of(Lanes const& eight) {
  Real out = 0;
  for (int i = 0; i < lane_count; ++i) out += eight[i];
  return out;
}

/// Some particles of one part, collected so that vectors pass over them.
class Block {
 public:
  explicit Block(std::size_t rows) : rows_(rows), values_((n + 1) * rows) {}

  bool has_room_for(int more) const { return filled_ + std::size_t(more) <= rows_; }
  void take(std::array<Lanes, n> const& values, Lanes const& weight) {
    for (std::size_t d = 0; d < n; ++d) store(column(d) + filled_, values[d]);
    store(column(n) + filled_, weight);
    filled_ += lane_count;
  }
  void take(std::array<Lanes, n> const& values, Lanes const& weight, int lane) {
    for (std::size_t d = 0; d < n; ++d) column(d)[filled_] = values[d][lane];
    column(n)[filled_] = weight[lane];
    ++filled_;
  }

  /// Hand over the moments of what is held, and hold nothing.
  BeamMoments moments() {
    BeamMoments out;
    if (filled_ == 0) return out;
    out.count = Real(filled_);
    fill_last_lanes();
    out.weight = total(n);
    for (std::size_t d = 0; d < n; ++d) subtract_mean(d, out);
    sum_products(out, std::make_index_sequence<n>{});
    for (std::size_t d = 0; d < 3; ++d) sum_plane(d, out);
    filled_ = 0;
    return out;
  }

 private:
  Real* column(std::size_t d) { return values_.data() + d * rows_; }
  Lanes at(std::size_t d, std::size_t row) { return load<Lanes>(column(d) + row); }

  /// Repeat the first particle, without weight, up to a whole vector.
  void fill_last_lanes() {
    for (; filled_ % lane_count != 0; ++filled_) {
      for (std::size_t d = 0; d < n; ++d) column(d)[filled_] = column(d)[0];
      column(n)[filled_] = 0;
    }
  }

  Real total(std::size_t d) {
    Lanes sum{};
    for (std::size_t row = 0; row < filled_; row += lane_count) sum += at(d, row);
    return sum_of(sum);
  }

  /// Replace a coordinate by its deviation from the mean, and note mean, extremes and what rounding leaves of the first
  /// moment.
  void subtract_mean(std::size_t d, BeamMoments& out) {
    Real const start = column(d)[0];
    Lanes sum{}, low = start + Lanes{}, high = low;
    for (std::size_t row = 0; row < filled_; row += lane_count) {
      Lanes const value = at(d, row);
      sum += at(n, row) * (value - start);
      low = select(value < low, value, low);
      high = select(value > high, value, high);
    }
    Real const mean = out.weight > 0 ? start + sum_of(sum) / out.weight : start;
    Lanes left{};
    for (std::size_t row = 0; row < filled_; row += lane_count) {
      Lanes const deviation = at(d, row) - mean;
      store(column(d) + row, deviation);
      left += at(n, row) * deviation;
    }
    out.centre[d] = mean;
    out.first[d] = sum_of(left);
    out.lowest[d] = out.highest[d] = start;
    for (int i = 0; i < lane_count; ++i) {
      out.lowest[d] = std::min<Real>(out.lowest[d], low[i]);
      out.highest[d] = std::max<Real>(out.highest[d], high[i]);
    }
  }

  template <std::size_t... i>
  void sum_products(BeamMoments& out, std::index_sequence<i...>) {
    (sum_products_with<i>(out), ...);
  }
  template <std::size_t i>
  void sum_products_with(BeamMoments& out) {
    std::array<Lanes, i + 1> sums{};
    for (std::size_t row = 0; row < filled_; row += lane_count) {
      Lanes const weighted = at(n, row) * at(i, row);
      for (std::size_t j = 0; j <= i; ++j) sums[j] += weighted * at(j, row);
    }
    for (std::size_t j = 0; j <= i; ++j) out.second[i][j] = out.second[j][i] = sum_of(sums[j]);
  }

  void sum_plane(std::size_t d, BeamMoments& out) {
    Lanes qqq{}, qqp{}, qpp{}, ppp{}, q4{}, q3p{}, qqpp{}, qp3{}, p4{};
    for (std::size_t row = 0; row < filled_; row += lane_count) {
      Lanes const q = at(d, row), p = at(d + 3, row), weight = at(n, row);
      Lanes const w_qq = weight * q * q, w_qp = weight * q * p, w_pp = weight * p * p;
      qqq += w_qq * q;
      qqp += w_qq * p;
      qpp += w_pp * q;
      ppp += w_pp * p;
      q4 += w_qq * (q * q);
      q3p += w_qq * (q * p);
      qqpp += w_qq * (p * p);
      qp3 += w_qp * (p * p);
      p4 += w_pp * (p * p);
    }
    auto& of = out.planes[d];
    of[0][0] = out.weight;
    of[1][0] = out.first[d];
    of[0][1] = out.first[d + 3];
    of[2][0] = out.second[d][d];
    of[1][1] = out.second[d][d + 3];
    of[0][2] = out.second[d + 3][d + 3];
    of[3][0] = sum_of(qqq);
    of[2][1] = sum_of(qqp);
    of[1][2] = sum_of(qpp);
    of[0][3] = sum_of(ppp);
    of[4][0] = sum_of(q4);
    of[3][1] = sum_of(q3p);
    of[2][2] = sum_of(qqpp);
    of[1][3] = sum_of(qp3);
    of[0][4] = sum_of(p4);
  }

  std::size_t rows_, filled_ = 0;
  std::vector<Real> values_;
};

std::array<Lanes, n> coordinates(BeamLanes const& of) {
  return {of.x[0], of.x[1], of.x[2], of.u[0], of.u[1], of.u[2], kinetic_energy(of)};
}

/// Those of this rank's particles.
std::vector<BeamMoments> local_moments(BeamView const& beam, BeamParts const& parts) {
  std::vector<BeamMoments> out(parts.count());
  if (beam.particles.count == 0 || out.empty()) return out;
  std::size_t const rows = std::clamp(rows_of_all / out.size() & ~std::size_t(lane_count - 1), least_rows, most_rows);
  std::vector<Block> blocks(out.size(), Block(rows));
  auto const block_of = [&](std::size_t part, int more) -> Block& {
    if (!blocks[part].has_room_for(more)) out[part].add(blocks[part].moments());
    return blocks[part];
  };
  for_each_of_parts(
      beam, parts,
      [&](std::size_t part, BeamLanes const& eight) {
        block_of(part, lane_count).take(coordinates(eight), eight.weight);
      },
      [&](std::size_t part, BeamLanes const& eight, int lane) {
        block_of(part, 1).take(coordinates(eight), eight.weight, lane);
      });
  for (std::size_t part = 0; part < out.size(); ++part) out[part].add(blocks[part].moments());
  return out;
}

constexpr std::array<std::array<Real, 5>, 5> binomial = {
    {{1, 0, 0, 0, 0}, {1, 1, 0, 0, 0}, {1, 2, 1, 0, 0}, {1, 3, 3, 1, 0}, {1, 4, 6, 4, 1}}};

/// The sums of (q + s)^a (p + t)^b from those of q^i p^j.
BeamMoments::Plane moved(BeamMoments::Plane const& of, Real s, Real t) {
  std::array<Real, 5> to_s{1}, to_t{1};
  for (std::size_t k = 1; k < 5; ++k) to_s[k] = to_s[k - 1] * s, to_t[k] = to_t[k - 1] * t;
  BeamMoments::Plane out{};
  for (std::size_t a = 0; a < 5; ++a)
    for (std::size_t b = 0; a + b < 5; ++b)
      for (std::size_t i = 0; i <= a; ++i)
        for (std::size_t j = 0; j <= b; ++j)
          out[a][b] += binomial[a][i] * binomial[b][j] * to_s[a - i] * to_t[b - j] * of[i][j];
  return out;
}

}  // namespace

BeamMoments::BeamMoments() {
  lowest.fill(std::numeric_limits<Real>::infinity());
  highest.fill(-std::numeric_limits<Real>::infinity());
}

void BeamMoments::move_by(Coordinates const& shift) {
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
      second[i][j] += shift[i] * first[j] + shift[j] * first[i] + weight * shift[i] * shift[j];
  for (std::size_t d = 0; d < 3; ++d) planes[d] = moved(planes[d], shift[d], shift[d + 3]);
  for (std::size_t i = 0; i < n; ++i) {
    first[i] += weight * shift[i];
    centre[i] -= shift[i];
  }
}

void BeamMoments::move_to_mean() {
  if (!(weight > 0)) return;
  Coordinates shift;
  for (std::size_t i = 0; i < n; ++i) shift[i] = -first[i] / weight;
  move_by(shift);
}

void BeamMoments::add(BeamMoments const& other) {
  if (other.count == 0) return;
  if (count == 0) {
    *this = other;
    return;
  }
  BeamMoments more = other;
  Real const total = weight + other.weight, share = total > 0 ? other.weight / total : 0;
  Coordinates here, there;
  for (std::size_t i = 0; i < n; ++i) {
    Real const apart = other.centre[i] - centre[i];
    here[i] = -share * apart;
    there[i] = apart + here[i];
  }
  Coordinates const from = centre;
  move_by(here);
  more.move_by(there);
  for (std::size_t i = 0; i < n; ++i) {
    centre[i] = from[i] - here[i];
    first[i] += more.first[i];
    for (std::size_t j = 0; j < n; ++j) second[i][j] += more.second[i][j];
    lowest[i] = std::min(lowest[i], other.lowest[i]);
    highest[i] = std::max(highest[i], other.highest[i]);
  }
  for (std::size_t d = 0; d < 3; ++d)
    for (std::size_t a = 0; a < 5; ++a)
      for (std::size_t b = 0; a + b < 5; ++b) planes[d][a][b] += more.planes[d][a][b];
  count += other.count;
  weight = total;
}

BeamMoments joined_moments(std::vector<BeamMoments> const& parts) {
  BeamMoments out;
  for (auto const& part : parts) out.add(part);
  out.move_to_mean();
  return out;
}

std::vector<BeamMoments> beam_moments(Communicator const& comm, BeamView const& beam, BeamParts const& parts) {
  auto out = local_moments(beam, parts);
  comm.add_each(out);
  for (auto& part : out) part.move_to_mean();
  return out;
}

}  // namespace amrpic
