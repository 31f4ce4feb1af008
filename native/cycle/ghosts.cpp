#include "cycle/ghosts.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <string>

namespace amrpic::cycle {

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

/// Call f(first cell, count, place) for the parts of a row of a box that lie side by side in the domain.
template <class F>
void for_each_part_in_domain(Level const& level, Box const& box, int j, int k, F&& f) {
  int const nx = box.extent(0);
  for (int i = 0; i < nx;) {
    Index3 const first = level.wrapped({box.lower[0] + i, box.lower[1] + j, box.lower[2] + k});
    int const count = std::min(nx - i, level.domain().upper[0] - first[0] + 1);
    f(first, count, i);
    i += count;
  }
}

}  // namespace

Stencil::Stencil(Level const& level, Layout const& layout, LevelFaces const& faces, GhostRules const& rules,
                 Equation const& equation, Real relaxation, bool in_differences, MetalCells const& metal)
    : relaxation_(relaxation), shift_(float(equation.shift)) {
  auto& weight = table_.weight;
  for (int d = 0; d < 3; ++d) weight[d] = is_its_own_neighbour(level, rules, d) ? 0 : float(equation.weight[d]);
  table_.isotropic = weight[0] == weight[1] && weight[1] == weight[2];
  table_.keep = float(1 - relaxation);
  table_.in_differences = in_differences;
  table_.zero_row = std::int32_t(layout.zero_row());
  for (CellBlock const& block : layout.blocks())
    table_.composed_pitch = std::max(table_.composed_pitch, std::int32_t(block.cells.pitch_y));
  std::size_t rows = 0;
  for (std::size_t b = 0; b < faces.size(); ++b)
    rows += std::size_t(layout.blocks()[b].box.extent(1)) * std::size_t(layout.blocks()[b].box.extent(2));
  rows_.reserve(rows);
  for (std::size_t b = 0; b < faces.size(); ++b) {
    CellBlock const& block = layout.blocks()[b];
    std::array<std::array<std::vector<Ghost>, 2>, 3> all;
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side)
        all[axis][side] =
            ghosts(level, layout, rules, metal, block, faces[b].sides[std::size_t(2 * axis + side)], axis, side);
    first_row_.push_back(std::int32_t(rows_.size()));
    first_composed_.push_back(std::int32_t(first_run_.size() - 1));
    add_rows(layout, b, all);
    add_coefficients(&rows_[std::size_t(first_row_[b])], block, all);
    if (metal.empty()) continue;
    add_metal(level, block, faces[b], rules, all, equation, metal, &rows_[std::size_t(first_row_[b])]);
    add_metal_planes(block, &rows_[std::size_t(first_row_[b])]);
  }
  first_row_.push_back(std::int32_t(rows_.size()));
  first_composed_.push_back(std::int32_t(first_run_.size() - 1));
  runs_.shrink_to_fit(), first_run_.shrink_to_fit();
  known_.clear();
  cut_values_.resize(cuts_.size());
  if (!metal_of_.empty()) metal_of_.resize(rows_.size(), -1);
}

RowTable Stencil::table() const {
  RowTable out = table_;
  out.rows = rows_.data(), out.runs = runs_.data(), out.first_run = first_run_.data(), out.coefficients = pool_.data();
  if (!metal_of_.empty()) out.metal_of = metal_of_.data();
  out.metal_rows = metal_rows_.data();
  out.cuts = cuts_.data(), out.solids = solids_.data(), out.cut_values = cut_values_.data();
  return out;
}

/// The layer behind a face, cell by cell, the lower tangential axis fastest.
std::vector<Ghost> Stencil::ghosts(Level const& level, Layout const& layout, GhostRules const& rules,
                                   MetalCells const& metal, CellBlock const& block, Face const& face, int axis,
                                   int side) {
  Box const& layer = face.layer;
  int const inward = side == 0 ? 1 : -1;
  bool const thick = block.box.extent(axis) > 1, ends = face.is_wall || face.has_coarser;
  // cells of the level behind the outer faces of copies are not stored here: their ghosts stay zero
  std::vector<Ghost> out(std::size_t(layer.cells()), Ghost{ends ? nothing : 0, 0, 0});
  auto const row_at = [&](Index3 const& first) { return &out[std::size_t(layer.offset(first))]; };
  auto fill_ghosts = [&](Index3 const& first) {
    Ghost* const row = row_at(first);
    Index3 cell = first, behind = first;
    cell[axis] += inward, behind[axis] += 2 * inward;
    std::ptrdiff_t const behind_first = thick ? block.place(behind) : 0;
    for (int i = 0; i < layer.extent(0); ++i, ++cell[0], ++behind[0]) {
      if (row[i].source != nothing) continue;
      WallGhost end = face.is_wall ? rules.walls[axis][side] : rules.inside(cell, axis, side);
      if (!face.is_wall && rules.inside_beside_metal && !metal.empty())
        if (auto const* const cut = metal.cut_at(level.wrapped(cell));
            cut && cut->is_cut(std::size_t(2 * axis + 1 - side)))
          end = *rules.inside_beside_metal;
      Ghost ghost{0, float(end.second), float(end.first)};
      if (face.is_wall && rules.more) ghost.first += float(rules.more(cell, axis, side));
      if (ghost.factor != 0) {
        std::ptrdiff_t const second = thick ? behind_first + i : layout.find(behind);
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
void Stencil::add_rows(Layout const& layout, std::size_t b,
                       std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts) {
  CellBlock const& block = layout.blocks()[b];
  int const nx = block.box.extent(0), ny = block.box.extent(1), nz = block.box.extent(2);
  Index3 const& lower = block.box.lower;
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j) {
      Row row{};
      row.place = std::int32_t(block.cells.place(0, j, k));
      row.pitch = std::int32_t(block.cells.pitch_y);
      row.cells = nx;
      row.lanes = std::int8_t(block.lanes);
      row.parity = std::int8_t((lower[0] + lower[1] + j + lower[2] + k) & 1);
      row.steps = b < layout.own_blocks() ? std::int8_t(0) : layout.steps_to_own(b, lower[2] + k)[j];
      auto beside = [&](int axis, int side, bool inside, int t) {
        std::ptrdiff_t const pitch = axis == 1 ? block.cells.pitch_y : block.cells.pitch_z;
        row.beside[std::size_t(2 * (axis - 1) + side)] =
            inside ? std::int32_t(row.place + (side == 0 ? -pitch : pitch))
                   : compose(&ghosts[axis][side][std::size_t(t) * nx], nx, row.place, layout.zero_row());
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
      rows_.push_back(row);
    }
}

/// The row that ghosts make: its place if it is one in memory, else ~(the composed row that is added).
std::int32_t Stencil::compose(Ghost const* ghosts, int n, std::ptrdiff_t own, std::ptrdiff_t zero_row) {
  std::int32_t const number = std::int32_t(first_run_.size() - 1), place = number * table_.composed_pitch;
  bool is_one = true;
  for (int begin = 0, end = 0; begin < n; begin = end) {
    Ghost const& first = ghosts[begin];
    auto const follows = [&](int i) {
      return ghosts[i].factor == first.factor && (first.factor == 0 || ghosts[i].source == first.source + i - begin);
    };
    for (end = begin + 1; end < n && follows(end);) ++end;
    is_one = end - begin == n && (first.factor == 0 || first.factor == 1);
    if (!is_one) runs_.push_back({place + begin, end - begin, first.source, first.factor, std::int32_t(own + begin)});
  }
  if (is_one) return ghosts->factor == 0 ? std::int32_t(zero_row) : ghosts->source;
  first_run_.push_back(std::int32_t(runs_.size()));
  return ~number;
}

void Stencil::add_coefficients(Row* rows, CellBlock const& block,
                               std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts) {
  int const nx = block.box.extent(0), ny = block.box.extent(1), nz = block.box.extent(2);
  auto const& weight = table_.weight;
  float const plain = 2 * (weight[0] + weight[1] + weight[2]) + shift_;
  std::vector<float> diagonal, held;
  std::map<std::array<float, 4>, std::int32_t> inner;  // of rows that no face of y and z changes, by their two ends
  std::vector<std::array<int, 2>> changing;            // axis and side of these faces
  for (int axis = 1; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      auto const& of = ghosts[axis][side];
      if (std::any_of(of.begin(), of.end(),
                      [&](Ghost const& g) { return g.first != 0 || (table_.in_differences && held_by(g) != 0); }))
        changing.push_back({axis, side});
    }
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j) {
      std::size_t const row = std::size_t(j + ny * k);
      Ghost const &lower = ghosts[0][0][row], &upper = ghosts[0][1][row];
      std::array<float, 4> const ends{lower.first, lower.factor, upper.first, upper.factor};
      auto const lies_at = [&](std::array<int, 2> const& face) {
        auto const [axis, side] = face;
        return (axis == 1 ? j : k) == (side == 0 ? 0 : block.box.extent(axis) - 1);
      };
      bool const inside = std::none_of(changing.begin(), changing.end(), lies_at);
      if (inside)
        if (auto const known = inner.find(ends); known != inner.end()) {
          rows[row].coefficients = known->second;
          continue;
        }
      diagonal.assign(std::size_t(nx), plain);
      diagonal.front() -= weight[0] * lower.first;
      diagonal.back() -= weight[0] * upper.first;
      held.assign(table_.in_differences ? std::size_t(nx) : 0, shift_);
      if (table_.in_differences) {
        held.front() += weight[0] * held_by(lower);
        held.back() += weight[0] * held_by(upper);
      }
      auto subtract = [&](int axis, int side, int t) {
        Ghost const* const g = &ghosts[axis][side][std::size_t(t) * nx];
        for (int i = 0; i < nx; ++i) diagonal[std::size_t(i)] -= weight[axis] * g[i].first;
        for (std::size_t i = 0; i < held.size(); ++i) held[i] += weight[axis] * held_by(g[i]);
      };
      for (auto const& face : changing)
        if (lies_at(face)) subtract(face[0], face[1], face[0] == 1 ? k : j);
      std::int32_t const start = pooled(std::size_t(block.cells.pitch_y), diagonal, held);
      if (inside) inner[ends] = start;
      rows[row].coefficients = start;
    }
}

template <class F>
void Stencil::for_each_metal_row(Row const* first, int count, F&& f) const {
  for (Row const* row = first; row != first + count; ++row) {
    std::size_t const n = std::size_t(row - rows_.data());
    if (n < metal_of_.size() && metal_of_[n] >= 0) f(*row, metal_rows_[std::size_t(metal_of_[n])]);
  }
}

CutPlace const* Stencil::cut_at(std::size_t row, int place) const {
  if (row >= metal_of_.size() || metal_of_[row] < 0) return nullptr;
  MetalRow const& metal = metal_rows_[std::size_t(metal_of_[row])];
  auto const first = cuts_.begin() + metal.first_cut, end = first + metal.cuts[0] + metal.cuts[1];
  auto const cut = std::find_if(first, end, [=](CutPlace const& c) { return c.place == place; });
  return cut == end ? nullptr : &*cut;
}

bool Stencil::is_solid(std::size_t row, int place) const {
  if (row >= metal_of_.size() || metal_of_[row] < 0) return false;
  MetalRow const& metal = metal_rows_[std::size_t(metal_of_[row])];
  auto const first = solids_.begin() + metal.first_solid;
  return std::any_of(first, first + metal.solids,
                     [=](SolidRun const& run) { return place >= run.place && place < run.place + run.count; });
}

float Stencil::weight_beyond(std::size_t block, int ny, Index3 const& at, std::size_t side) const {
  CutPlace const* const cut = cut_at(std::size_t(first_row_[block] + at[1] + ny * at[2]), at[0]);
  return cut ? cut->weight[side] : table_.weight[side / 2];
}

float Stencil::diagonal(std::size_t block, int ny, Index3 const& at) const {
  std::size_t const row = std::size_t(first_row_[block] + at[1] + ny * at[2]);
  CutPlace const* const cut = cut_at(row, at[0]);
  if (is_solid(row, at[0])) return 0;
  return cut ? cut->diagonal : pool_[std::size_t(rows_[row].coefficients + at[0])];
}

/// The equations of cut cells, and where solid ones are.
void Stencil::add_metal(Level const& level, CellBlock const& block, BoxFaces const& faces, GhostRules const& rules,
                        std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts, Equation const& equation,
                        MetalCells const& metal, Row* rows) {
  int const ny = block.box.extent(1), nz = block.box.extent(2);
  auto const arms_of = [&](Index3 const& at, CutCell const& cut) {
    std::array<Arm, 6> out;
    for (std::size_t n = 0; n < 6; ++n) {
      int const axis = int(n) / 2, side = int(n) % 2;
      bool const ends = at[axis] == (side == 0 ? 0 : block.box.extent(axis) - 1);
      bool const wall = ends && faces.sides[n].is_wall;
      out[n] = arm_of(cut, n);
      if (!ends) continue;
      auto const [u, v] = tangential_axes(axis);
      out[n].first = ghosts[axis][side][std::size_t(at[u] + block.box.extent(u) * at[v])].first;
      out[n].is_parabola = wall && rules.walls[axis][side].second != 0;
    }
    return out;
  };
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j) {
      std::array<std::vector<CutPlace>, 2> cuts;
      std::vector<SolidRun> solids;
      for_each_part_in_domain(level, block.box, j, k, [&](Index3 const& first, int count, int place) {
        metal.for_each_cut(first, count, [&](CutCell const& cut) {
          Index3 const at{place + cut.cell[0] - first[0], j, k};
          CutRow const row = cut_row(equation, arms_of(at, cut), cut.hold);
          CutPlace out{at[0], {}, float(row.diagonal), float(relaxation_ / row.diagonal)};
          for (std::size_t n = 0; n < 6; ++n) {
            out.weight[n] = float(row.neighbour(n));
            reads_solids_ = reads_solids_ || (!cut.is_cut(n) && cut.arm[n] <= 1);
          }
          cuts[std::size_t(at[0] % 2)].push_back(out);
        });
        metal.for_each_solid(first, count, [&](SolidCell const& solid) {
          int const i = place + solid.cell[0] - first[0];
          if (!solids.empty() && solids.back().place + solids.back().count == i)
            ++solids.back().count;
          else
            solids.push_back({i, 1});
        });
      });
      add_metal_row(rows[j + ny * k], cuts, solids);
    }
}

void Stencil::add_metal_row(Row const& row, std::array<std::vector<CutPlace>, 2> const& cuts,
                            std::vector<SolidRun> const& solids) {
  if (cuts[0].empty() && cuts[1].empty() && solids.empty()) return;
  metal_of_.resize(rows_.size(), -1);
  metal_of_[std::size_t(&row - rows_.data())] = std::int32_t(metal_rows_.size());
  metal_rows_.push_back({std::int32_t(cuts_.size()),
                         {std::int32_t(cuts[0].size()), std::int32_t(cuts[1].size())},
                         std::int32_t(solids_.size()),
                         std::int32_t(solids.size()),
                         !solids.empty() && solids.front().count == row.cells});
  for (auto const& of_parity : cuts) cuts_.insert(cuts_.end(), of_parity.begin(), of_parity.end());
  solids_.insert(solids_.end(), solids.begin(), solids.end());
}

/// The same by planes: what a thread does to a whole one costs less than row by row.
void Stencil::add_metal_planes(CellBlock const& block, Row const* rows) {
  first_plane_.push_back(std::int32_t(metal_planes_.size()));
  for (int k = 0; k < block.box.extent(2); ++k) {
    MetalPlane& plane = metal_planes_.emplace_back();
    for (int colour = 0; colour < 2; ++colour) {
      plane.inner[std::size_t(colour)].first = std::int32_t(inner_cuts_.size());
      plane.outer[std::size_t(colour)].first = std::int32_t(outer_cuts_.size());
      for_each_metal_row(
          rows + k * block.box.extent(1), block.box.extent(1), [&](Row const& row, MetalRow const& metal) {
            std::size_t const parity = std::size_t((row.parity + colour) & 1);
            std::array<std::ptrdiff_t, 4> const step{-block.cells.pitch_y, block.cells.pitch_y, -block.cells.pitch_z,
                                                     block.cells.pitch_z};
            bool lies_between = true;
            for (std::size_t side = 0; side < 4; ++side)
              lies_between = lies_between && row.beside[side] >= 0 && row.beside[side] == row.place + step[side];
            int const first = metal.first_cut + (parity == 0 ? 0 : metal.cuts[0]);
            for (int n = first; n < first + metal.cuts[parity]; ++n) {
              CutPlace const& cut = cuts_[std::size_t(n)];
              if (lies_between && cut.place > 0 && cut.place + 1 < row.cells)
                inner_cuts_.push_back({cut.weight, cut.step}), inner_places_.push_back(row.place + cut.place);
              else
                outer_cuts_.push_back(outer_cut(row, cut));
            }
          });
      plane.inner[std::size_t(colour)].last = std::int32_t(inner_cuts_.size());
      plane.outer[std::size_t(colour)].last = std::int32_t(outer_cuts_.size());
    }
    plane.solids.first = std::int32_t(solids_in_planes_.size());
    for_each_metal_row(rows + k * block.box.extent(1), block.box.extent(1), [&](Row const& row, MetalRow const& metal) {
      for (int n = metal.first_solid; n < metal.first_solid + metal.solids; ++n)
        solids_in_planes_.push_back({row.place + solids_[std::size_t(n)].place, solids_[std::size_t(n)].count});
    });
    plane.solids.last = std::int32_t(solids_in_planes_.size());
  }
}

/// A cut cell with the values that correction rows would have beside it.
OuterCut Stencil::outer_cut(Row const& row, CutPlace const& cut) const {
  OuterCut out{row.place + cut.place, {}, cut.weight, cut.step};
  auto const set = [&](std::size_t side, std::int32_t place, float factor) {
    out.beside[side] = place;
    out.weight[side] *= factor;
  };
  for (std::size_t side = 0; side < 2; ++side) {
    bool const ends = cut.place == (side == 0 ? 0 : row.cells - 1);
    set(side, ends ? row.end[side] : out.place + (side == 0 ? -1 : 1), ends ? row.factor[side] : 1);
  }
  for (std::size_t side = 0; side < 4; ++side) {
    std::int32_t const beside = row.beside[side];
    if (beside >= 0) {
      set(2 + side, beside + cut.place, 1);
      continue;
    }
    std::int32_t const place = ~beside * table_.composed_pitch + cut.place;
    ScaledRun const* run = &runs_[std::size_t(first_run_[std::size_t(~beside)])];
    while (place >= run->place + run->count) ++run;
    set(2 + side, run->source + place - run->place, run->factor);
  }
  return out;
}

std::int32_t Stencil::pooled(std::size_t pitch, std::vector<float> const& diagonal, std::vector<float> const& held) {
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
    pool_.resize(start +
                 ((table_.in_differences ? RowTable::held_place + 1 : RowTable::held_place) * pitch + 15) / 16 * 16);
    std::copy(held.begin(), held.end(), pool_.begin() + std::ptrdiff_t(start + RowTable::held_place * pitch));
    for (std::size_t i = 0; i < diagonal.size(); ++i) {
      pool_[start + i] = diagonal[i];
      pool_[start + (1 + i % 2) * pitch + i] = diagonal[i] == 0 ? 0 : float(relaxation_) / diagonal[i];
    }
  }
  return at->second;
}

std::size_t Stencil::bytes() const {
  return pool_.size() * sizeof(float) + rows_.size() * sizeof(Row) + runs_.size() * sizeof(ScaledRun) +
         first_run_.size() * sizeof(std::int32_t) + metal_rows_.size() * sizeof(MetalRow) +
         cuts_.size() * (sizeof(CutPlace) + sizeof(float)) + solids_.size() * sizeof(SolidRun) +
         metal_planes_.size() * sizeof(MetalPlane) + inner_cuts_.size() * (sizeof(InnerCut) + sizeof(std::int32_t)) +
         outer_cuts_.size() * sizeof(OuterCut) + solids_in_planes_.size() * sizeof(SolidRun);
}

}  // namespace amrpic::cycle
