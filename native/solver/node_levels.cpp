#include "solver/node_levels.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "mesh/array_on_box.hpp"

namespace amrpic {

namespace {

constexpr GlobalIndex most_nodes_of_bottom = 64;
constexpr Real vanishing = 1e-13;  ///< pivots, in parts of the diagonal

std::vector<Real> inverse_of(std::vector<Real> diagonal) {
  for (Real& value : diagonal) value = value > 0 ? 1 / value : 0;
  return diagonal;
}

void keep_free(std::vector<Real> const& free, std::vector<Real>& v) {
  for (std::size_t i = 0; i < v.size(); ++i) v[i] *= free[i];
}

}  // namespace

std::vector<Real> disordered(Level const& nodes, int components) {
  std::vector<Real> out;
  out.reserve(std::size_t(nodes.local_cells()) * std::size_t(components));
  for (int b = nodes.first_local_box(); b < nodes.last_local_box(); ++b)
    for_each_cell(nodes.box(b), [&](Index3 const& at) {
      auto const number = std::uint64_t(nodes.domain().offset(at)) * 3;
      for (int c = 0; c < components; ++c)
        out.push_back(Real((number + std::uint64_t(c)) * 2654435761u % 65537) / 65537 - Real(0.5));
    });
  return out;
}

DenseBottom::DenseBottom(Communicator const& comm, fem::NodeBlocks const& blocks) : comm_(comm) {
  ::amrpic::Level const& nodes = *blocks.nodes;
  std::size_t const c = std::size_t(blocks.components);
  for (int rank = 0; rank < nodes.ranks(); ++rank) {
    starts_.push_back(int(nodes.first_cell(rank)) * blocks.components);
    counts_.push_back(int(nodes.first_cell(rank + 1) - nodes.first_cell(rank)) * blocks.components);
  }
  first_ = std::size_t(starts_[std::size_t(nodes.rank())]);
  size_ = std::size_t(nodes.cells()) * c;
  auto const all = comm.gather(blocks.value).values;
  factor_.assign(size_ * size_, 0), whole_.resize(size_);
  auto const numbers = cell_numbers(nodes, nodes.domain().grow(1));
  Real const* entry = all.data();
  for (Box const& box : nodes.boxes())
    for_each_cell(box, [&](Index3 const& at) {
      std::size_t const row = std::size_t(numbers(at)) * c;
      for_each_cell(Box{at, at}.grow(1), [&](Index3 const& other) {
        for (std::size_t r = 0; r < c; ++r)
          for (std::size_t k = 0; k < c; ++k, ++entry)
            if (numbers(other) != no_cell) factor_[(row + r) * size_ + std::size_t(numbers(other)) * c + k] = *entry;
      });
    });
  std::vector<Real> pivot(size_), scaled(size_);
  for (std::size_t i = 0; i < size_; ++i) {
    Real* const row = &factor_[i * size_];
    Real const whole = row[i];
    for (std::size_t j = 0; j < i; ++j) {
      Real const* const other = &factor_[j * size_];
      for (std::size_t k = 0; k < j; ++k) row[j] -= row[k] * other[k];  // row is L D here, other L
      scaled[j] = inverse_pivot_[j] * row[j];
    }
    Real left = whole;
    for (std::size_t j = 0; j < i; ++j) left -= row[j] * scaled[j], row[j] = scaled[j];
    inverse_pivot_.push_back(std::abs(left) > vanishing * std::abs(whole) ? 1 / std::abs(left) : 0);
  }
}

void DenseBottom::solve(std::vector<Real> const& b, std::vector<Real>& x) {
  comm_.gather_into(b.data(), counts_, starts_, whole_.data());
  for (std::size_t i = 0; i < size_; ++i)
    for (std::size_t k = 0; k < i; ++k) whole_[i] -= factor_[i * size_ + k] * whole_[k];
  for (std::size_t i = 0; i < size_; ++i) whole_[i] *= inverse_pivot_[i];
  for (std::size_t i = size_; i-- > 0;)
    for (std::size_t k = 0; k < i; ++k) whole_[k] -= factor_[i * size_ + k] * whole_[i];
  std::copy_n(&whole_[first_], x.size(), x.begin());
}

NodeLevels::NodeLevels(Communicator const& comm, fem::NodeBlocks blocks) {
  while (blocks.nodes->cells() > most_nodes_of_bottom) {
    auto halving = std::make_unique<fem::Halving>(comm, blocks.nodes);
    if (halving->coarse()->cells() == blocks.nodes->cells()) break;
    auto coarse = halving->galerkin(blocks);
    auto const start = disordered(*blocks.nodes, blocks.components);
    int const components = blocks.components;
    auto const free = blocks.free;
    // The smoother keeps a pointer to the rows, so a level stays where it is made.
    auto level = std::unique_ptr<Level>(
        new Level{components, free, fem::BlockRows(comm, std::move(blocks)), {}, std::move(halving), {}, {}});
    fem::BlockRows const& kept = level->rows;
    level->smoother = std::make_unique<Chebyshev>(
        comm, [&kept](std::vector<Real> const& u, std::vector<Real>& v) { kept.apply(u.data(), v.data()); },
        by_diagonal(inverse_of(kept.diagonal())), start);
    blocks = std::move(coarse);
    level->coarse_r.resize(blocks.free.size()), level->coarse_z.resize(blocks.free.size());
    levels_.push_back(std::move(level));
  }
  bottom_ = std::make_unique<DenseBottom>(comm, blocks);
}

void NodeLevels::cycle(std::size_t number, std::vector<Real> const& r, std::vector<Real>& z) {
  if (number == levels_.size()) return bottom_->solve(r, z);
  Level& level = *levels_[number];
  level.smoother->smooth(r, z, true);
  auto& residual = level.smoother->residual(r, z);
  keep_free(level.free, residual);
  level.to_coarser->transposed(level.components, residual.data(), level.coarse_r.data());
  cycle(number + 1, level.coarse_r, level.coarse_z);
  level.to_coarser->add(level.components, level.coarse_z.data(), z.data());
  keep_free(level.free, z);
  level.smoother->smooth(r, z, false);
}

}  // namespace amrpic
