#include "base/lanes.hpp"
#include "matrixfree/composite.hpp"
#include "mesh/means.hpp"

namespace amrpic {

namespace {

constexpr int children = 8;  ///< of a cell

}  // namespace

/// Give the means of a level's cells, box by box, to the covered cells of the coarser level, whose rim is all of their
/// box.
void CompositeLaplacian::give_means(int l, Real const* means, ElectricField& field) {
  constexpr std::ptrdiff_t width = ElectricField::rim_width;
  LevelPlan& coarse = plan_.levels[std::size_t(l) - 1];
  auto const first_of = [&](int b) { return means + width * (level(l).local_offset(b) / children); };
  auto const parents_of = [&](int b) { return level(l).box(b).coarsen(refinement_ratio); };
  auto const at_rim = [&](LocalIndex place) { return field.at_rim(l - 1) + width * field.rim(l - 1).number(place); };

  for (int b = 0; b < boxes(l); ++b)
    for (int f = plan(l, b).families.first; f < plan(l, b).families.last; ++f) {
      Family const& family = plan(l).families[std::size_t(f)];
      int const box = level(l).first_local_box() + b;
      Index3 const pitch = pitches(parents_of(box));
      Real const* from = first_of(box);
      for (int d = 0; d < 3; ++d) from += width * (family.child[d] / 2) * pitch[d];
      Real* const to = at_rim(family.parent);
      for (int k = 0; k < family.parents[2]; ++k)
        for (int j = 0; j < family.parents[1]; ++j)
          std::copy_n(from + width * (j * pitch[1] + k * pitch[2]), width * family.parents[0],
                      to + width * (j * family.pitch_y + k * family.pitch_z));
    }

  for (int axis = 0; axis < 3; ++axis) {
    coarse.finer_means.start([&](Piece const& piece, Real* out) {
      for_each_cell(piece.part, [&](Index3 const& parent) {
        *out++ = first_of(piece.box)[width * parents_of(piece.box).offset(parent) + axis];
      });
    });
    coarse.finer_means.finish();
    for (RemoteMeans const& m : coarse.remote_means) {
      Real const* from = coarse.finer_means.values(m.owner) + m.from;
      Real* const to = at_rim(m.parent);
      for (int k = 0; k < m.parents[2]; ++k)
        for (int j = 0; j < m.parents[1]; ++j)
          for (int i = 0; i < m.parents[0]; ++i) {
            Real* const cell = to + width * (i + j * m.pitch_y + k * m.pitch_z);
            cell[axis] = *from++;
          }
    }
  }
}

/// Set the means of planes k and k + 1 of a box, which are under way, box by box.
void CompositeLaplacian::average_field(int l, int b, int k, Real* means) {
  Box const parents = box(l, b).coarsen(refinement_ratio);
  std::ptrdiff_t const nx = parents.extent(0), plane = nx * parents.extent(1);
  Real* to = means + ElectricField::rim_width * (offset(l, b) / children + k / 2 * plane);
  std::array<Real*, 3> const row{fits_.data(), fits_.data() + nx, coarse_.data()};
  for (int j = 0; j < parents.extent(1); ++j, to += ElectricField::rim_width * nx) {
    for (int d = 0; d < 3; ++d)
      average_children(int(nx), plane_.data() + 2 * d * 4 * plane + 4 * j * nx, 2 * nx, 4 * plane, row[d]);
    write_cells({row[0], row[1], row[2]}, int(nx), to);
  }
}

ElectricField CompositeLaplacian::electric_field(std::shared_ptr<Field const> potential,
                                                 std::vector<Walls> const& walls, CoveredField covered) {
  Field const& phi = *potential;
  std::vector<Real3> factor(std::size_t(hierarchy_->level_count()));
  for (std::size_t l = 0; l < factor.size(); ++l)
    for (int d = 0; d < 3; ++d) factor[l][d] = factor_of_field(int(l), d);
  ElectricField out(std::move(potential), std::move(factor));

  bool const averages = covered == CoveredField::mean;
  std::vector<LargeArray<Real>> means(std::size_t(hierarchy_->level_count()));  // of each level's cells
  for (int l = 1; averages && l < hierarchy_->level_count(); ++l)
    means[std::size_t(l)].resize(ElectricField::rim_width * std::size_t(level(l).local_cells() / children));

  auto planes_of = [&](int l, int b, int k) {  // set two by two, in memory that all boxes share
    std::array<Real*, 3> e;
    for (int d = 0; d < 3; ++d) e[d] = plane_.data() + (2 * d + k % 2) * std::ptrdiff_t(pitches(box(l, b))[2]);
    return e;
  };
  auto set_box = [&](int l, int b) {
    bool const whole = out.rim(l).is_whole(b), is_averaged = averages && l > 0 && !whole;
    for (int k = 0; k < box(l, b).extent(2); ++k) {
      auto const e = planes_of(l, b, k);
      field_plane(l, b, k, whole || is_averaged ? Where::everywhere : Where::at_faces, phi, e);
      out.set_rim(l, b, k, {e[0], e[1], e[2]});
      if (is_averaged && k % 2 == 1) average_field(l, b, k - 1, means[std::size_t(l)].data());
    }
  };
  auto finish_level = [&](int l) {  // covered cells first, then the means that take these in
    stream_end();
    if (averages && hierarchy_->has_finer(l)) give_means(l + 1, means[std::size_t(l) + 1].data(), out);
    for (int b = 0; b < boxes(l) && averages && l > 0; ++b)
      for (int k = 0; out.rim(l).is_whole(b) && k < box(l, b).extent(2); ++k) {
        out.write_plane(l, b, k, planes_of(l, b, k));
        if (k % 2 == 1) average_field(l, b, k - 1, means[std::size_t(l)].data());
      }
  };
  visit(phi, walls, averages ? Hidden::skip : Hidden::visit, set_box, finish_level);
  return out;
}

}  // namespace amrpic
