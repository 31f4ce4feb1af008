#include "solver/element_solves.hpp"

#include <algorithm>
#include <cmath>

#include "fem/degrees.hpp"
#include "fem/elements.hpp"

namespace amrpic {

namespace {

using fem::GroupValues;
using fem::V;
using Filled = std::vector<fem::Points::Filled>;

/// Of the stiffest point of an element: grains and binder beside air are uneven, grains beside binder are not.
constexpr Real soft = Real(1) / 30;
constexpr Real hardly = 1e-3;  ///< pivots of a matrix that is hardly positive, in parts of the diagonal

/// The first entry of a column of a lower triangle with so many, which is that on the diagonal.
constexpr std::ptrdiff_t column_start(int size, int column) {
  return std::ptrdiff_t(column) * size - std::ptrdiff_t(column) * (column - 1) / 2;
}
constexpr std::ptrdiff_t entries_of(int size) { return column_start(size, size); }

/// L in place of a matrix, of each lane, column by column; reciprocals on the diagonal. A matrix that is not positive,
/// or hardly so, becomes its diagonal.
void factor_lanes(int size, V* entries) {
  std::vector<V, fem::BlockAllocator<V>> diagonal;
  for (int j = 0; j < size; ++j) diagonal.push_back(entries[column_start(size, j)]);
  V positive = V{} + Real(1);
  for (int j = 0; j < size; ++j) {
    V* const column = entries + column_start(size, j);
    int const length = size - j;
    auto const before = [&](int k) { return entries + column_start(size, k) + (j - k); };
    int k = 0;
    for (; k + 4 <= j; k += 4) {
      V const *const a = before(k), *const b = before(k + 1), *const c = before(k + 2), *const d = before(k + 3);
      V const by_a = a[0], by_b = b[0], by_c = c[0], by_d = d[0];
      for (int i = 0; i < length; ++i) column[i] -= by_a * a[i] + by_b * b[i] + by_c * c[i] + by_d * d[i];
    }
    for (; k < j; ++k) {
      V const* const a = before(k);
      V const by_a = a[0];
      for (int i = 0; i < length; ++i) column[i] -= by_a * a[i];
    }
    V inverse_root;
    for (int l = 0; l < native_lane_count; ++l) {
      bool const large = column[0][l] > hardly * diagonal[std::size_t(j)][l];
      if (!large) positive[l] = 0;
      inverse_root[l] = 1 / std::sqrt(large ? column[0][l] : diagonal[std::size_t(j)][l]);
    }
    column[0] = inverse_root;
    for (int i = 1; i < length; ++i) column[i] *= inverse_root;
  }
  for (int l = 0; l < native_lane_count; ++l) {
    if (positive[l] > 0) continue;
    for (int j = 0; j < size; ++j)
      for (int i = j; i < size; ++i)
        entries[column_start(size, j) + i - j][l] = i == j ? 1 / std::sqrt(diagonal[std::size_t(j)][l]) : 0;
  }
}

V widened(float const* at) { return __builtin_convertvector(load<HalfFloats>(at), V); }

/// Solves with such factors in single precision, a lane for each element.
template <int P, int C>
struct Solve {
  static constexpr bool reads = true, writes = true;
  static constexpr int size = C * P * P * P;
  float const* factors;

  void operator()(LocalIndex const* numbers, int, GroupValues<P, C>& values) const {
    float const* const first = factors + numbers[0] * entries_of(size);
    V* const x = &values.value[0][0];
    for (int j = 0; j < size; ++j) {
      float const* at = first + column_start(size, j) * native_lane_count;
      V const known = x[j] *= widened(at);
      for (int i = j + 1; i < size; ++i) x[i] -= widened(at += native_lane_count) * known;
    }
    for (int j = size; j-- > 0;) {
      float const* const diagonal = first + column_start(size, j) * native_lane_count;
      float const* at = diagonal;
      V sums[4] = {x[j], V{}, V{}, V{}};
      int i = j + 1;
      for (; i + 4 <= size; i += 4)
        for (int s = 0; s < 4; ++s) sums[s] -= widened(at += native_lane_count) * x[i + s];
      for (; i < size; ++i) sums[0] -= widened(at += native_lane_count) * x[i];
      x[j] = (sums[0] + sums[1] + (sums[2] + sums[3])) * widened(diagonal);
    }
  }
};

/// What the nodes of groups of elements have.
template <int P, int C>
struct KeepNodes {
  static constexpr bool reads = true, writes = false;
  V* out;
  void operator()(LocalIndex const* numbers, int, GroupValues<P, C> const& values) const {
    std::copy_n(&values.value[0][0], C * P * P * P, out + numbers[0] / native_lane_count * (C * P * P * P));
  }
};

/// One for each element that a node belongs to.
template <int P, int C>
struct Count {
  static constexpr bool reads = false, writes = true;
  void operator()(LocalIndex const*, int, GroupValues<P, C>& values) const {
    std::fill_n(&values.value[0][0], C * P * P * P, V{} + Real(1));
  }
};

}  // namespace

Filled uneven_elements(fem::Operator const& a) {
  fem::Points const& points = a.points();
  auto const stiffness = a.stiffness_of_points();
  std::vector<Real> of_element;
  Filled out;
  for (auto const& filled : points.filled()) {
    auto& found = out.emplace_back();
    for (std::size_t e = 0; e < filled.element.size(); ++e) {
      LocalIndex const element = filled.element[e];
      auto const first = points.first_point(points.first_block(element));
      auto const last = points.first_point(points.first_block(element + 1));
      of_element.assign(stiffness.begin() + first, stiffness.begin() + last);
      auto const middle = of_element.begin() + std::ptrdiff_t(of_element.size() / 2);
      std::nth_element(of_element.begin(), middle, of_element.end());
      if (!(*middle < soft * *std::max_element(middle, of_element.end()))) continue;
      found.element.push_back(element), found.corner.push_back(filled.corner[e]);
    }
  }
  return out;
}

ElementSolves::ElementSolves(fem::Operator const& a, std::vector<Real> const& inverse)
    : lattice_(a.points().lattice()), components_(a.components()), count_(0), inverse_(inverse) {
  auto const uneven = uneven_elements(a);
  LocalIndex groups = 0;
  for (auto const& part : uneven) {
    numbered_.push_back(part);
    LocalIndex number = groups * native_lane_count;
    for (LocalIndex& one : numbered_.back().element) one = number++;
    groups += (LocalIndex(part.element.size()) + native_lane_count - 1) / native_lane_count;
    count_ += GlobalIndex(part.element.size());
  }
  count_ = lattice_.comm().sum(count_);
  if (count_ == 0) return;
  share(inverse);
  factor(a, uneven, inverse);
}

void ElementSolves::share(std::vector<Real> const& inverse) {
  share_.assign(inverse.size(), 0), shared_.resize(inverse.size());
  fem::with_shape(lattice_.degree(), components_, [&](auto nodes, auto of_node) {
    fem::sum_over_elements<nodes(), of_node()>(lattice_, numbered_, nullptr, share_.data(),
                                               Count<nodes(), of_node()>{});
  });
  for (std::size_t i = 0; i < share_.size(); ++i) {
    if (share_[i] > 0) inverse_[i] = 0;
    share_[i] = share_[i] > 0 && inverse[i] > 0 ? 1 / std::sqrt(share_[i]) : 0;
  }
}

void ElementSolves::factor(fem::Operator const& a, Filled const& uneven, std::vector<Real> const& inverse) {
  std::vector<Real> diagonal;
  for (Real value : inverse) diagonal.push_back(value > 0 ? 1 / value : 0);
  std::size_t groups = 0;
  for (auto const& part : uneven) groups += (part.element.size() + native_lane_count - 1) / native_lane_count;
  fem::with_shape(lattice_.degree(), components_, [&](auto nodes, auto of_node) {
    constexpr int size = of_node() * nodes() * nodes() * nodes();
    constexpr std::ptrdiff_t entries = entries_of(size);
    std::vector<V, fem::BlockAllocator<V>> at_nodes(groups * size), lower(entries);
    fem::sum_over_elements<nodes(), of_node()>(lattice_, numbered_, diagonal.data(), nullptr,
                                               KeepNodes<nodes(), of_node()>{at_nodes.data()});
    factors_.resize(groups * entries * native_lane_count);
    std::size_t group = 0, part = 0;
    int lane = 0;
    auto const finish = [&] {
      if (lane == 0) return;
      for (; lane < native_lane_count; ++lane)
        for (int j = 0; j < size; ++j)
          for (int i = j; i < size; ++i) lower[std::size_t(column_start(size, j) + i - j)][lane] = i == j;
      factor_lanes(size, lower.data());
      for (std::ptrdiff_t e = 0; e < entries; ++e)
        store(&factors_[(group * entries + std::size_t(e)) * native_lane_count],
              __builtin_convertvector(lower[std::size_t(e)], HalfFloats));
      ++group, lane = 0;
    };
    a.for_each_matrix_of(uneven, [&](std::size_t p, LocalIndex, std::vector<Real> const& matrix) {
      if (p != part) finish(), part = p;
      V const* const whole = &at_nodes[group * size];
      for (int j = 0; j < size; ++j) {
        V* const column = &lower[std::size_t(column_start(size, j))];
        bool const free = whole[j][lane] > 0;
        column[0][lane] = free ? whole[j][lane] : 1;
        for (int i = j + 1; i < size; ++i)
          column[i - j][lane] = free && whole[i][lane] > 0 ? matrix[std::size_t(j * size + i)] : 0;
      }
      if (++lane == native_lane_count) finish();
    });
    finish();
  });
}

void ElementSolves::apply(std::vector<Real> const& r, std::vector<Real>& z) {
  for (std::size_t i = 0; i < r.size(); ++i) shared_[i] = share_[i] * r[i];
  fem::with_shape(lattice_.degree(), components_, [&](auto nodes, auto of_node) {
    fem::sum_over_elements<nodes(), of_node()>(lattice_, numbered_, shared_.data(), z.data(),
                                               Solve<nodes(), of_node()>{factors_.data()});
  });
  for (std::size_t i = 0; i < r.size(); ++i) z[i] = share_[i] * z[i] + inverse_[i] * r[i];
}

}  // namespace amrpic
