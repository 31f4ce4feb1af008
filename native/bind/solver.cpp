#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "base/constants.hpp"
#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "solver/poisson.hpp"
#include "solver/work_unit.hpp"

void bind_solver(nb::module_& m) {
  m.attr("vacuum_permittivity") = vacuum_permittivity;
  nb::enum_<Norm>(m, "Norm").value("l1", Norm::l1).value("l2", Norm::l2).value("max", Norm::max);
  nb::enum_<Prolongation>(m, "Prolongation")
      .value("constant", Prolongation::constant)
      .value("trilinear", Prolongation::trilinear);
  nb::enum_<SmootherKind>(m, "Smoother")
      .value("red_black", SmootherKind::red_black)
      .value("jacobi", SmootherKind::jacobi)
      .value("gauss_seidel", SmootherKind::gauss_seidel)
      .value("symmetric_gauss_seidel", SmootherKind::symmetric_gauss_seidel)
      .value("chebyshev", SmootherKind::chebyshev);
  nb::enum_<BottomKind>(m, "Bottom")
      .value("gmres", BottomKind::gmres)
      .value("cg", BottomKind::cg)
      .value("bicgstab", BottomKind::bicgstab)
      .value("multigrid", BottomKind::multigrid)
      .value("direct", BottomKind::direct);
  nb::enum_<BottomPreconditioner>(m, "BottomPreconditioner")
      .value("none", BottomPreconditioner::none)
      .value("jacobi", BottomPreconditioner::jacobi)
      .value("gauss_seidel", BottomPreconditioner::gauss_seidel)
      .value("ilu", BottomPreconditioner::ilu)
      .value("smoothed_aggregation", BottomPreconditioner::smoothed_aggregation)
      .value("plain_aggregation", BottomPreconditioner::plain_aggregation)
      .value("brick_aggregation", BottomPreconditioner::brick_aggregation)
      .value("structured_aggregation", BottomPreconditioner::structured_aggregation);
  nb::enum_<KrylovKind>(m, "Krylov")
      .value("none", KrylovKind::none)
      .value("fgmres", KrylovKind::fgmres)
      .value("bicgstab", KrylovKind::bicgstab);

  nb::enum_<BackendKind>(m, "Backend")
      .value("matrix_free", BackendKind::matrix_free)
      .value("kokkos", BackendKind::kokkos)
      .value("crs", BackendKind::crs);

  nb::enum_<CoveredField>(m, "CoveredField")
      .value("mean", CoveredField::mean)
      .value("difference", CoveredField::difference);

  nb::enum_<Holds>(m, "Holds").value("points", Holds::points).value("means", Holds::means);

  nb::class_<WorkUnit>(m, "WorkUnit")
      .def_ro("seconds", &WorkUnit::seconds)
      .def_ro("apply_seconds", &WorkUnit::apply_seconds)
      .def_ro("triad_throughput", &WorkUnit::triad_throughput);
  m.def("measure_work_unit", &measure_work_unit, "cells"_a, nb::call_guard<nb::gil_scoped_release>());

  nb::class_<SolverOptions>(m, "SolverOptions")
      .def(nb::init<>())
      .def_rw("backend", &SolverOptions::backend)
      .def_rw("tolerance", &SolverOptions::tolerance)
      .def_rw("to_discretisation", &SolverOptions::to_discretisation)
      .def_rw("absolute_tolerance", &SolverOptions::absolute_tolerance)
      .def_rw("norm", &SolverOptions::norm)
      .def_rw("order", &SolverOptions::order)
      .def_rw("max_cycles", &SolverOptions::max_cycles)
      .def_rw("smoother", &SolverOptions::smoother)
      .def_rw("pre_sweeps", &SolverOptions::pre_sweeps)
      .def_rw("post_sweeps", &SolverOptions::post_sweeps)
      .def_rw("relaxation", &SolverOptions::relaxation)
      .def_rw("prolongation", &SolverOptions::prolongation)
      .def_rw("screening", &SolverOptions::screening)
      .def_rw("stretch", &SolverOptions::stretch)
      .def_prop_rw(
          "across", [](SolverOptions const& o) { return o.across.axis; },
          [](SolverOptions& o, int axis) { o.across.axis = axis; })
      .def_prop_rw(
          "mirror_places", [](SolverOptions const& o) { return o.across.place; },
          [](SolverOptions& o, std::array<double, 2> const& place) { o.across.place = place; })
      .def_prop_rw(
          "mirror_signs", [](SolverOptions const& o) { return o.across.sign; },
          [](SolverOptions& o, std::array<int, 2> const& sign) { o.across.sign = sign; })
      .def_rw("coarse_levels", &SolverOptions::coarse_levels)
      .def_rw("bottom", &SolverOptions::bottom)
      .def_rw("bottom_preconditioner", &SolverOptions::bottom_preconditioner)
      .def_rw("krylov", &SolverOptions::krylov)
      .def_rw(
          "most_direct_readers", &SolverOptions::most_direct_readers,
          "Coarser corrections that more than so many ranks read of one pass through others. The same on all ranks.")
      .def_rw("neutralize", &SolverOptions::neutralize);

  nb::class_<MeshError>(m, "MeshError")
      .def(nb::init<Real, Real, Real, int>(), "error"_a = 0.0, "contraction"_a = 0.0, "right_hand_side"_a = 0.0,
           "solves"_a = 0)
      .def_ro("error", &MeshError::error)
      .def_ro("contraction", &MeshError::contraction)
      .def_ro("right_hand_side", &MeshError::right_hand_side)
      .def_ro("solves", &MeshError::solves);
  m.attr("SOLVES_PER_ESTIMATE") = nb::int_(MeshError::lasts + 1);  // of the error of the mesh

  nb::class_<SolveReport>(m, "SolveReport")
      .def_ro("converged", &SolveReport::converged)
      .def_ro("cycles", &SolveReport::cycles)
      .def_ro("residuals", &SolveReport::residuals)
      .def_ro("floor", &SolveReport::floor)
      .def_ro("mesh_error", &SolveReport::mesh_error)
      .def_ro("reason", &SolveReport::reason)
      .def_ro("seconds", &SolveReport::seconds);

  nb::class_<Reusable>(m, "Reusable").def(nb::init<>());
  using Cells = nb::ndarray<std::int64_t const, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
  using Owners = nb::ndarray<std::int32_t const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
  using Arms = nb::ndarray<Real const, nb::shape<-1, 6>, nb::c_contig, nb::device::cpu>;
  using Surfaces = nb::ndarray<std::int32_t const, nb::shape<-1, 6>, nb::c_contig, nb::device::cpu>;
  using Widths = nb::ndarray<Real const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
  nb::class_<Metal>(m, "Metal")
      .def(
          "__init__",
          [](Metal* self, int electrodes, nb::callable ask) {
            // ask(boxes, spacing): the first of each run of solid cells, how many these are, and their electrode; cut
            // cells, their arms and electrodes
            new (self) Metal(electrodes, [ask](std::vector<Box> const& boxes, Real3 const& spacing) {
              nb::gil_scoped_acquire held;
              std::vector<std::array<int, 6>> corners;
              for (auto const& [lower, upper] : boxes)
                corners.push_back({lower[0], lower[1], lower[2], upper[0], upper[1], upper[2]});
              auto const [solid, count, owner, cut, arm, electrode] =
                  nb::cast<std::tuple<Cells, Owners, Owners, Cells, Arms, Surfaces>>(
                      ask(corners, std::array<Real, 3>{spacing[0], spacing[1], spacing[2]}));
              auto const cell = [](Cells const& of, std::size_t n) {
                return Index3{int(of(n, 0)), int(of(n, 1)), int(of(n, 2))};
              };
              std::pair<std::vector<CutCell>, std::vector<SolidCells>> out;
              out.first.reserve(cut.shape(0)), out.second.reserve(solid.shape(0));
              for (std::size_t n = 0; n < solid.shape(0); ++n)
                out.second.push_back({cell(solid, n), count(n), owner(n)});
              for (std::size_t n = 0; n < cut.shape(0); ++n) {
                CutCell& to = out.first.emplace_back();
                to.cell = cell(cut, n);
                for (std::size_t side = 0; side < 6; ++side)
                  to.arm[side] = arm(n, side), to.electrode[side] = electrode(n, side);
              }
              return out;
            });
          },
          "electrodes"_a, "ask"_a);
  nb::class_<PoissonSolver>(m, "PoissonSolver")
      .def(nb::init<std::shared_ptr<Hierarchy const>, SolverOptions const&, Reusable const&,
                    std::shared_ptr<Metal const>>(),
           "hierarchy"_a, "options"_a, "reusable"_a, "metal"_a.none() = nullptr,
           nb::call_guard<nb::gil_scoped_release>())
      .def("set_potentials", &PoissonSolver::set_potentials, "potentials"_a)
      .def(
          "add_gaps",
          [](PoissonSolver& solver, int level, Surfaces const& gaps, Widths const& widths) {
            // of each gap: cell (3), axis, electrodes below and above
            std::vector<Gap> out;
            for (std::size_t n = 0; n < gaps.shape(0); ++n)
              out.push_back({{gaps(n, 0), gaps(n, 1), gaps(n, 2)}, gaps(n, 3), {gaps(n, 4), gaps(n, 5)}, widths(n)});
            solver.add_gaps(level, out);
          },
          "level"_a, "gaps"_a, "widths"_a)
      .def("charges", &PoissonSolver::charges, "phi"_a, "rho"_a, nb::call_guard<nb::gil_scoped_release>())
      .def("sights", &PoissonSolver::sights, nb::call_guard<nb::gil_scoped_release>())
      .def("solve", &PoissonSolver::solve, "rho"_a, "phi"_a, "from_zero"_a, "known"_a, "deposited"_a,
           "images"_a = false, nb::call_guard<nb::gil_scoped_release>())
      .def("electric_field", &PoissonSolver::electric_field, "potential"_a, "covered"_a,
           nb::call_guard<nb::gil_scoped_release>())
      .def("electric_field_as", &PoissonSolver::electric_field_as, "potential"_a, "covered"_a, "holds"_a,
           nb::call_guard<nb::gil_scoped_release>())
      .def("to_means", &PoissonSolver::to_means, "points"_a, "means"_a, nb::call_guard<nb::gil_scoped_release>())
      .def(
          "wall_faces",
          [](PoissonSolver& solver, int level) {
            // kind, axis and position of each wall face of this rank
            Walls const& walls = solver.walls(level);
            std::vector<int> kind, axis;
            std::vector<Real> position;
            for (std::size_t i = 0; i < walls.faces.size(); ++i) {
              kind.push_back(int(walls.faces[i].kind));
              axis.push_back(walls.faces[i].axis);
              Real3 const x = walls.position(solver.hierarchy().domain(), solver.hierarchy().level(level), i);
              position.insert(position.end(), x.begin(), x.end());
            }
            std::size_t const n = kind.size();
            return nb::make_tuple(bind::to_array(std::move(kind)), bind::to_array(std::move(axis)),
                                  bind::to_array(std::move(position), {n, 3}));
          },
          "level"_a)
      .def(
          "wall_data",
          [](nb::handle self, int level) {
            auto& datum = nb::cast<PoissonSolver&>(self).walls(level).datum;
            return nb::ndarray<nb::numpy, Real>(datum.data(), {datum.size()}, self);
          },
          "level"_a)
      .def("continue_walls", &PoissonSolver::continue_walls, "potentials"_a, nb::call_guard<nb::gil_scoped_release>())
      .def_prop_ro("reusable", &PoissonSolver::reusable, nb::rv_policy::copy)
      .def_prop_ro("bottom_setups", [](PoissonSolver const& s) { return s.backend().bottom_setups(); })
      .def_prop_ro("levels_assembled", [](PoissonSolver const& s) { return s.backend().levels_assembled(); })
      .def_prop_ro("assemblies", [](PoissonSolver const& s) { return s.backend().assemblies(); })
      .def_prop_ro("backend_bytes", [](PoissonSolver const& s) { return s.backend().bytes(); });
}
