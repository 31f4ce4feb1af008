#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "base/error.hpp"
#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "composite/composite.hpp"
#include "cycle/capacity.hpp"
#include "cycle/cycle.hpp"

namespace {

using Values = std::vector<bind::Reals>;  ///< [level]

/// The walls of a hierarchy with given data.
std::vector<Walls> walls_of(Hierarchy const& hierarchy, Values const& data) {
  std::vector<Walls> out;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    out.push_back(find_walls(hierarchy.domain(), hierarchy.level(l)));
    out.back().datum.assign(data[std::size_t(l)].data(), data[std::size_t(l)].data() + data[std::size_t(l)].size());
  }
  return out;
}

/// The same for a Laplacian that reads them. Raises SolverError where it reads more.
std::vector<Walls> walls_of(CompositeLaplacian const& laplacian, Values const& data) {
  Hierarchy const& hierarchy = laplacian.hierarchy();
  if (laplacian.is_of_means() && hierarchy.domain().has(Boundary::open))
    throw SolverError(
        "behind open walls the Laplacian of order 4 reads two layers of potentials, which a PoissonSolver finds "
        "from the charge; close the walls, or take order 2");
  return walls_of(hierarchy, data);
}

/// Numbers of all levels in blocks whose rows and planes have room to spare.
template <class T>
class Padded {
 public:
  explicit Padded(Hierarchy const& hierarchy) : hierarchy_(hierarchy) {
    for (int l = 0; l < hierarchy.level_count(); ++l) {
      Level const& level = hierarchy.level(l);
      std::vector<std::size_t> starts{0};
      for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
        starts.push_back(starts.back() + std::size_t(pitch_z(level.box(b))) * std::size_t(level.box(b).extent(2)));
      values_.emplace_back(starts.back(), unset);
      blocks_.emplace_back();
      for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
        blocks_.back().push_back({values_.back().data() + starts[std::size_t(b - level.first_local_box())],
                                  pitch_y(level.box(b)), pitch_z(level.box(b))});
    }
  }
  Blocks<T> const& blocks() const { return blocks_; }

  /// Call f(value in its block, place among the own cells of the level) for each cell of a level.
  template <class F>
  void for_each(int l, F&& f) {
    Level const& level = hierarchy_.level(l);
    std::size_t place = 0;
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
      Block<T> const& block = blocks_[std::size_t(l)][std::size_t(b - level.first_local_box())];
      Box const& box = level.box(b);
      for (int k = 0; k < box.extent(2); ++k)
        for (int j = 0; j < box.extent(1); ++j)
          for (int i = 0; i < box.extent(0); ++i) f(block.origin[i + j * block.pitch_y + k * block.pitch_z], place++);
    }
  }
  std::vector<nb::ndarray<nb::numpy, T>> to_arrays() {
    std::vector<nb::ndarray<nb::numpy, T>> out;
    for (int l = 0; l < hierarchy_.level_count(); ++l) {
      std::vector<T> values(std::size_t(hierarchy_.level(l).local_cells()));
      for_each(l, [&](T value, std::size_t place) { values[place] = value; });
      out.push_back(bind::to_array(std::move(values)));
    }
    return out;
  }
  /// Whether nothing was written between the rows.
  bool clean() {
    std::size_t set = 0, cells = 0;
    for (auto const& level : values_)
      for (T value : level) set += value != unset;
    for (int l = 0; l < hierarchy_.level_count(); ++l)
      for_each(l, [&](T value, std::size_t) { cells += value != unset; });
    return set == cells;
  }

 private:
  static constexpr T unset = T(-7.25e30);
  static std::ptrdiff_t pitch_y(Box const& box) { return box.extent(0) + 3; }
  static std::ptrdiff_t pitch_z(Box const& box) { return pitch_y(box) * (box.extent(1) + 1); }
  Hierarchy const& hierarchy_;
  std::vector<std::vector<T>> values_;
  Blocks<T> blocks_;
};

template <class T>
nb::tuple residual(CompositeLaplacian& laplacian, Field const& rho, Real mean, Values const& walls, Field const& phi,
                   Norm norm, std::vector<Real> const& scale) {
  Padded<T> out(laplacian.hierarchy());
  Real size;
  auto const data = walls_of(laplacian, walls);
  {
    nb::gil_scoped_release release;
    size = laplacian.residual({rho, data, mean}, phi, norm, scale, out.blocks());
  }
  return nb::make_tuple(size, out.to_arrays(), out.clean());
}

nb::tuple truncation(CompositeLaplacian& laplacian, Field const& rho, Real mean, Values const& walls, Field const& phi,
                     Index3 const& base_ratio, std::vector<Real> const& scale) {
  Padded<float> out(laplacian.hierarchy());
  auto const data = walls_of(laplacian, walls);
  {
    nb::gil_scoped_release release;
    laplacian.truncation({rho, data, mean}, phi, base_ratio, scale, out.blocks());
  }
  return nb::make_tuple(out.to_arrays(), out.clean());
}

}  // namespace

void bind_matrixfree(nb::module_& m) {
  m.def(
      "padded_cells",
      [](std::vector<std::array<int, 6>> const& boxes, int halo) {
        std::vector<Box> all;
        for (auto const& b : boxes) all.push_back({{b[0], b[1], b[2]}, {b[3], b[4], b[5]}});
        return cycle::padded_cells(all, halo);
      },
      "boxes"_a, "halo"_a, "The most padded cells that boxes, each lower x, y, z and upper x, y, z, take with a halo.");
  m.def("refusal_of_places", &cycle::refusal_of_places, "places"_a, "level"_a, "rank"_a,
        "What is wrong with so many padded cells of a level on a rank; empty if nothing is.");
  nb::class_<cycle::LevelWork>(m, "LevelWork")
      .def_ro("level", &cycle::LevelWork::level, "0: the base; negative below it.")
      .def_ro("cells", &cycle::LevelWork::cells, "Of this rank.")
      .def_ro("stored", &cycle::LevelWork::stored, "Cells with copies of others'.")
      .def_ro("relaxed", &cycle::LevelWork::relaxed, "Cells relaxed; without copies, cells times sweeps.")
      .def_ro("sweeps", &cycle::LevelWork::sweeps)
      .def_ro("neighbours", &cycle::LevelWork::neighbours, "Ranks with which this one exchanges values.")
      .def_prop_ro("messages", [](cycle::LevelWork const& w) { return w.traffic.messages; })
      .def_prop_ro("bytes", [](cycle::LevelWork const& w) { return w.traffic.bytes; })
      .def_prop_ro("collectives", [](cycle::LevelWork const& w) { return w.traffic.collectives; });
  m.def(
      "cycle_work",
      [](std::shared_ptr<Hierarchy const> hierarchy, int pre_sweeps, int post_sweeps, Real screening,
         Real3 const& stretch, int most_direct_readers) {
        nb::gil_scoped_release release;
        auto const stretched = hierarchy->stretched(stretch);
        return cycle::Cycle(stretched->comm(), *stretched, screening * screening, {pre_sweeps, post_sweeps}, 2,
                            std::make_shared<GapFits>(), most_direct_readers)
            .work();
      },
      "hierarchy"_a, "pre_sweeps"_a, "post_sweeps"_a, "screening"_a = 0.0, "stretch"_a = Real3{1, 1, 1},
      "most_direct_readers"_a = cycle::most_direct_readers,
      "What one cycle takes of this rank, by levels, the coarsest first: it is rehearsed, and messages are counted. "
      "Local "
      "for a virtual rank, else collective.");
  nb::class_<cycle::CyclePlans>(m, "CyclePlans")
      .def(
          "__init__",
          [](cycle::CyclePlans* self, std::shared_ptr<Hierarchy const> hierarchy, int pre_sweeps, int post_sweeps,
             Real screening, Real3 const& stretch) {
            nb::gil_scoped_release release;
            new (self)
                cycle::CyclePlans(hierarchy->stretched(stretch), screening * screening, {pre_sweeps, post_sweeps});
          },
          "hierarchy"_a, "pre_sweeps"_a, "post_sweeps"_a, "screening"_a = 0.0, "stretch"_a = Real3{1, 1, 1},
          "What all ranks know of the cycle on the hierarchy of a virtual rank. Local.")
      .def("work", &cycle::CyclePlans::work, "rank"_a, nb::call_guard<nb::gil_scoped_release>(),
           "What `cycle_work` gives of another rank. Local.");
  nb::class_<Means>(m, "Means", "Leads from values at the centres of cells to means over them, and back.")
      .def(nb::init<std::shared_ptr<Hierarchy const>>(), "hierarchy"_a, nb::call_guard<nb::gil_scoped_release>())
      .def("to_points", &Means::to_points, "means"_a, "points"_a, nb::call_guard<nb::gil_scoped_release>())
      .def("to_means", &Means::to_means, "points"_a, "means"_a, nb::call_guard<nb::gil_scoped_release>());
  nb::class_<CompositeLaplacian>(m, "CompositeLaplacian")
      .def(
          "__init__",
          [](CompositeLaplacian* self, std::shared_ptr<Hierarchy const> hierarchy, Real3 stretch, Real shift,
             int order) {
            nb::gil_scoped_release release;
            new (self) CompositeLaplacian(hierarchy->stretched(stretch), shift, stretch, order);
          },
          "hierarchy"_a, "stretch"_a, "shift"_a = 0.0, "order"_a = 2)
      .def("average_down", &CompositeLaplacian::average_down, "phi"_a, nb::call_guard<nb::gil_scoped_release>())
      .def(
          "add",
          [](CompositeLaplacian& laplacian, Values const& correction, Real scale, Field& phi) {
            Padded<float> in(laplacian.hierarchy());
            for (int l = 0; l < laplacian.hierarchy().level_count(); ++l)
              in.for_each(
                  l, [&](float& value, std::size_t place) { value = float(correction[std::size_t(l)].data()[place]); });
            nb::gil_scoped_release release;
            laplacian.add(in.blocks(), scale, phi);
          },
          "correction"_a, "scale"_a, "phi"_a)
      .def("residual", &residual<Real>, "rho"_a, "mean"_a, "walls"_a, "phi"_a, "norm"_a, "scale"_a)
      .def("single_residual", &residual<float>, "rho"_a, "mean"_a, "walls"_a, "phi"_a, "norm"_a, "scale"_a)
      .def("truncation", &truncation, "rho"_a, "mean"_a, "walls"_a, "phi"_a, "base_ratio"_a, "scale"_a)
      .def(
          "right_hand_side_norm",
          [](CompositeLaplacian& laplacian, Field const& rho, Real mean, Values const& walls, Norm norm) {
            auto const data = walls_of(laplacian, walls);
            nb::gil_scoped_release release;
            return laplacian.right_hand_side_norm({rho, data, mean}, norm);
          },
          "rho"_a, "mean"_a, "walls"_a, "norm"_a)
      .def(
          "integrate_right_hand_side",
          [](CompositeLaplacian& laplacian, Field const& rho, Real mean, Values const& walls) {
            auto const data = walls_of(laplacian, walls);
            nb::gil_scoped_release release;
            auto const sums = laplacian.integrate_right_hand_side({rho, data, mean});
            return std::pair<Real, Real>(sums.net, sums.magnitude);
          },
          "rho"_a, "mean"_a, "walls"_a)
      .def("diagonal_norm", &CompositeLaplacian::diagonal_norm, "phi"_a, "norm"_a,
           nb::call_guard<nb::gil_scoped_release>())
      .def(
          "electric_field",
          [](CompositeLaplacian& laplacian, std::shared_ptr<Field const> potential, Values const& walls,
             CoveredField covered) {
            auto const data = walls_of(laplacian, walls);
            nb::gil_scoped_release release;
            return laplacian.electric_field(std::move(potential), data, covered);
          },
          "potential"_a, "walls"_a, "covered"_a)
      .def_prop_ro("bytes", &CompositeLaplacian::bytes);
}
