#include "matrixfree/ghosts.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <string>

namespace amrpic::matrixfree {

namespace {

constexpr std::int32_t nothing = -1;  ///< the source of a ghost that is not known yet

/// Whether a level has a single cell along an axis, with its own value on either side; periodic axes of one cell have
/// such walls too.
bool is_its_own_neighbour(Level const& level, GhostRules const& rules, int axis) {
  auto is_copy = [](WallGhost const& ghost) { return ghost.first == 1 && ghost.second == 0; };
  return level.domain().extent(axis) == 1 && is_copy(rules.walls[axis][0]) && is_copy(rules.walls[axis][1]);
}

/// What a ghost of equal values lacks of them: nothing, up to rounding, where they may be constant.
float held_by(Ghost const& ghost) {
  float const out = 1 - ghost.first - ghost.factor;
  return std::abs(out) < 1e-6f ? 0 : out;
}

}  // namespace

Stencil::Stencil(Level const& level, Layout const& layout, LevelFaces const& faces, GhostRules const& rules,
                 Equation const& equation, Real relaxation, bool in_differences)
    : relaxation_(relaxation),
      shift_(float(equation.shift)),
      keep_(float(1 - relaxation)),
      in_differences_(in_differences) {
  for (int d = 0; d < 3; ++d) weight_[d] = is_its_own_neighbour(level, rules, d) ? 0 : float(equation.weight[d]);
  for (std::size_t b = 0; b < faces.size(); ++b) {
    CellBlock const& block = layout.blocks()[b];
    BlockStencil out;
    out.rows.reserve(std::size_t(block.box.extent(1)) * std::size_t(block.box.extent(2)));
    std::array<std::array<std::vector<Ghost>, 2>, 3> all;
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side)
        all[axis][side] = ghosts(level, layout, rules, block, faces[b].sides[std::size_t(2 * axis + side)], axis, side);
    add_rows(out, layout, block, all);
    add_coefficients(out, block, all);
    blocks_.push_back(std::move(out));
  }
  known_.clear();
}

/// The layer behind a face, cell by cell, the lower tangential axis fastest.
std::vector<Ghost> Stencil::ghosts(Level const& level, Layout const& layout, GhostRules const& rules,
                                   CellBlock const& block, Face const& face, int axis, int side) {
  Box const& layer = face.layer;
  int const inward = side == 0 ? 1 : -1;
  bool const thick = block.box.extent(axis) > 1, ends = face.is_wall || face.has_coarser;
  // cells of the level behind the outer faces of copies are not stored here: their ghosts stay zero
  std::vector<Ghost> out(std::size_t(layer.cells()), Ghost{ends ? nothing : 0, 0, 0});
  auto const row_at = [&](Index3 const& first) { return &out[std::size_t(layer.offset(first))]; };
  auto fill_ghosts = [&](Index3 const& first) {
    Ghost* const row = row_at(first);
    for (int i = 0; i < layer.extent(0); ++i) {
      if (row[i].source != nothing) continue;
      Index3 cell{first[0] + i, first[1], first[2]};
      cell[axis] += inward;
      WallGhost const end = face.is_wall ? rules.walls[axis][side] : rules.inside(cell, axis, side);
      Ghost ghost{0, float(end.second), float(end.first)};
      if (face.is_wall && rules.more) ghost.first += float(rules.more(cell, axis, side));
      if (ghost.factor != 0) {
        cell[axis] += inward;
        std::ptrdiff_t const second = thick ? block.place(cell) : layout.find(cell);
        if (second < 0) ghost.factor = 0;
        if (second >= 0) ghost.source = std::int32_t(second);
      }
      row[i] = ghost;
    }
  };
  if (face.has_coarser)
    for (Overlap const& o : face.neighbours)
      for_each_row(o.part, [&](Index3 const& first) { std::fill_n(row_at(first), o.part.extent(0), Ghost{}); });
  if (!face.is_wall) {
    int const n = level.domain().extent(axis);
    float const factor =
        level.periodic()[axis] ? float(seam_factor(layer.lower[axis] + inward, side, n, rules.seam_width[axis])) : 1;
    layout.for_each_overlap(layer, [&](CellBlock const& other, Box const& part, Index3 const& shift) {
      for_each_row(part, [&](Index3 const& first) {
        Ghost* const row = row_at(first);
        std::ptrdiff_t const place = other.place({first[0] - shift[0], first[1] - shift[1], first[2] - shift[2]});
        for (int i = 0; i < part.extent(0); ++i) row[i] = {std::int32_t(place + i), factor, 1 - factor};
      });
    });
  }
  if (ends) for_each_row(layer, fill_ghosts);
  return out;
}

/// What lies on each side of each row.
void Stencil::add_rows(BlockStencil& out, Layout const& layout, CellBlock const& block,
                       std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts) {
  int const nx = block.box.extent(0), ny = block.box.extent(1), nz = block.box.extent(2);
  out.first_run.push_back(0);
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j) {
      RowStencil row{};
      auto beside = [&](int axis, int side, bool inside, int t) {
        std::ptrdiff_t const pitch = axis == 1 ? block.cells.pitch_y : block.cells.pitch_z;
        row.beside[std::size_t(2 * (axis - 1) + side)] =
            inside ? std::int32_t(block.cells.place(0, j, k) + (side == 0 ? -pitch : pitch))
                   : compose(out, &ghosts[axis][side][std::size_t(t) * nx], nx, block.cells.place(0, j, k),
                             layout.zero_row());
      };
      beside(1, 0, j > 0, k);
      beside(1, 1, j + 1 < ny, k);
      beside(2, 0, k > 0, j);
      beside(2, 1, k + 1 < nz, j);
      for (int side = 0; side < 2; ++side) {
        Ghost const& end = ghosts[0][side][std::size_t(j + ny * k)];
        row.end[side] = end.source;
        row.factor[side] = end.factor;
      }
      out.rows.push_back(row);
    }
}

/// The row that ghosts make: its place if it is one in memory, else ~(the composed row that is added).
std::int32_t Stencil::compose(BlockStencil& out, Ghost const* ghosts, int n, std::ptrdiff_t own,
                              std::ptrdiff_t zero_row) {
  std::size_t const first = std::size_t(out.first_run.back());
  for (int i = 0; i < n; ++i) {
    Ghost const& g = ghosts[i];
    bool const follows = i > 0 && out.runs.back().factor == g.factor &&
                         (g.factor == 0 || g.source == out.runs.back().source + out.runs.back().count);
    if (follows)
      ++out.runs.back().count;
    else
      out.runs.push_back({i, 1, g.source, g.factor, std::int32_t(own + i)});
  }
  if (ScaledRun const run = out.runs[first]; run.count == n && (run.factor == 0 || run.factor == 1)) {
    out.runs.pop_back();
    return run.factor == 0 ? std::int32_t(zero_row) : run.source;
  }
  out.first_run.push_back(std::int32_t(out.runs.size()));
  return ~std::int32_t(out.first_run.size() - 2);
}

void Stencil::add_coefficients(BlockStencil& out, CellBlock const& block,
                               std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts) {
  int const nx = block.box.extent(0), ny = block.box.extent(1), nz = block.box.extent(2);
  float const plain = 2 * (weight_[0] + weight_[1] + weight_[2]) + shift_;
  std::vector<float> diagonal, held;
  std::map<std::array<float, 4>, std::int32_t> inner;  // of rows away from the faces of y and z, by their two ends
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j) {
      std::size_t const row = std::size_t(j + ny * k);
      Ghost const &lower = ghosts[0][0][row], &upper = ghosts[0][1][row];
      std::array<float, 4> const ends{lower.first, lower.factor, upper.first, upper.factor};
      bool const inside = j > 0 && j < ny - 1 && k > 0 && k < nz - 1;
      if (inside)
        if (auto const known = inner.find(ends); known != inner.end()) {
          out.rows[row].coefficients = known->second;
          continue;
        }
      diagonal.assign(std::size_t(nx), plain);
      diagonal.front() -= weight_[0] * lower.first;
      diagonal.back() -= weight_[0] * upper.first;
      held.assign(in_differences_ ? std::size_t(nx) : 0, shift_);
      if (in_differences_) {
        held.front() += weight_[0] * held_by(lower);
        held.back() += weight_[0] * held_by(upper);
      }
      auto subtract = [&](int axis, int side, int t) {
        Ghost const* const g = &ghosts[axis][side][std::size_t(t) * nx];
        for (int i = 0; i < nx; ++i) diagonal[std::size_t(i)] -= weight_[axis] * g[i].first;
        for (std::size_t i = 0; i < held.size(); ++i) held[i] += weight_[axis] * held_by(g[i]);
      };
      if (j == 0) subtract(1, 0, k);
      if (j == ny - 1) subtract(1, 1, k);
      if (k == 0) subtract(2, 0, j);
      if (k == nz - 1) subtract(2, 1, j);
      std::int32_t const start = pooled(block, diagonal, held);
      if (inside) inner[ends] = start;
      out.rows[row].coefficients = start;
    }
}

std::int32_t Stencil::pooled(CellBlock const& block, std::vector<float> const& diagonal,
                             std::vector<float> const& held) {
  std::size_t const pitch = std::size_t(block.cells.pitch_y);
  std::string key;
  auto const append = [&](auto const* values, std::size_t n) {
    key.append(reinterpret_cast<char const*>(values), n * sizeof *values);
  };
  append(diagonal.data(), diagonal.size());
  append(held.data(), held.size());
  append(&pitch, 1);
  auto const [at, fresh] = known_.emplace(key, std::int32_t(pool_.size()));
  if (fresh) {
    std::size_t const start = pool_.size();
    pool_.resize(start + ((in_differences_ ? held_place + 1 : held_place) * pitch + 15) / 16 * 16);
    std::copy(held.begin(), held.end(), pool_.begin() + std::ptrdiff_t(start + held_place * pitch));
    for (std::size_t i = 0; i < diagonal.size(); ++i) {
      pool_[start + i] = diagonal[i];
      pool_[start + (1 + i % 2) * pitch + i] = diagonal[i] == 0 ? 0 : float(relaxation_) / diagonal[i];
    }
  }
  return at->second;
}

std::size_t Stencil::bytes() const {
  std::size_t sum = pool_.size() * sizeof(float);
  for (BlockStencil const& b : blocks_)
    sum += b.rows.capacity() * sizeof(RowStencil) + b.runs.capacity() * sizeof(ScaledRun) +
           b.first_run.capacity() * sizeof(std::int32_t);
  return sum;
}

}  // namespace amrpic::matrixfree
