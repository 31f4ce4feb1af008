#include "solver/poisson.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <sstream>
#include <utility>

#include "base/constants.hpp"
#include "base/error.hpp"
#include "freespace/density.hpp"
#include "freespace/free_space.hpp"
#include "multigrid/nearly_free.hpp"
#include "multigrid/semicoarse.hpp"
#include "solver/compressed_rows.hpp"
#include "solver/kokkos_backend.hpp"
#include "solver/metal_room.hpp"
#include "solver/net_charge.hpp"

namespace amrpic {

namespace {

std::string scientific(Real value) {
  std::ostringstream out;
  out.precision(2);
  out << std::scientific << value;
  return out.str();
}

}  // namespace

PoissonSolver::PoissonSolver(std::shared_ptr<Hierarchy const> hierarchy, SolverOptions const& options,
                             Reusable const& reusable, std::shared_ptr<Metal const> metal)
    : given_(std::move(hierarchy)),
      hierarchy_((options.across.axis < 0 ? given_ : given_->opened(options.across.axis))->stretched(options.stretch)),
      options_(options),
      reusable_(reusable),
      metal_(std::move(metal)),
      potentials_(metal_ ? std::size_t(metal_->electrodes()) : 0) {
  if (metal_) require_room_around(*metal_, *hierarchy_, options_.stretch);
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    walls_.push_back(find_walls(hierarchy_->domain(), hierarchy_->level(l)));
  Problem const problem{hierarchy_, options_, walls_, metal_, potentials_};
  if (options_.backend == BackendKind::crs)
    backend_ = make_crs_backend(problem, reusable_);
  else if (options_.backend == BackendKind::kokkos)
    backend_ = make_kokkos_backend(problem);
  else
    backend_ = std::make_unique<Backend>(problem);
  if (metal_) metal_->forget();
  if (hierarchy_->domain().has(Boundary::open)) plan_open_walls();
}

void PoissonSolver::plan_open_walls() {
  int const layers = freespace::Options::of(options_.order).layers();
  freespace::Across across = options_.across;
  if (across.axis >= 0)
    for (Real& place : across.place) place *= options_.stretch[across.axis];
  freespace::WallMesh const mesh = freespace::wall_mesh(*hierarchy_, layers, across);
  bool const has_images = !mesh.images.are_none();
  auto const options =
      freespace::Options::of(options_.order, has_images, mesh.images.lattices(), mesh.images.are_narrow());
  if (!reusable_.free_space || !reusable_.free_space->is_for(has_images, options))
    reusable_.free_space =
        std::make_shared<freespace::FreeSpace>(hierarchy_->comm(), mesh.lattice, has_images, options);
  wall_plan_ = reusable_.free_space->plan(mesh);
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    if (layers > 1) walls_[l].second.assign(walls_[l].faces.size(), 0.0);
    for (std::size_t i = 0; i < walls_[l].faces.size(); ++i) {
      auto const& face = walls_[l].faces[i];
      if (face.kind != Boundary::open) continue;
      OpenFace& open = open_faces_.emplace_back(OpenFace{l, i, {}});
      for (int n = 0; n < layers; ++n)
        open.places[std::size_t(n)] = wall_plan_->place(2 * face.axis + face.side, n, l, face.cell);
    }
  }
}

void PoissonSolver::continue_walls(freespace::PerFace const& potentials) {
  if (!wall_plan_) return;
  freespace::Options const& options = reusable_.free_space->options();
  wall_charges_ = wall_charges(*hierarchy_, walls_, potentials, options);
  if (potentials == plates_) return;
  plates_ = potentials;
  Real3 const& finest = hierarchy_->level(hierarchy_->level_count() - 1).spacing();
  Real const gauss = options_.order == 4 ? 1 / std::sqrt(12.0) : 0;  // ghosts hold means
  freespace::Plates const plates(hierarchy_->domain(), potentials,
                                 (0.5 - gauss) * std::min({finest[0], finest[1], finest[2]}));
  of_plates_.resize(open_faces_.size());
  std::size_t first = 0;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    Real3 const& h = hierarchy_->level(l).spacing();
    std::size_t last = first;
    while (last < open_faces_.size() && open_faces_[last].level == l) ++last;
    for (std::size_t n = 0; n < std::size_t(options.layers()); ++n) {
      std::vector<Real3> places;
      for (std::size_t i = first; i < last; ++i) {
        auto const& face = walls_[l].faces[open_faces_[i].face];
        Real3 x = walls_[l].position(hierarchy_->domain(), hierarchy_->level(l), open_faces_[i].face);
        x[face.axis] += (face.side == 0 ? -1 : 1) * Real(n) * h[face.axis];
        places.push_back(x);
      }
      auto const values = plates.at(places, {gauss * h[0], gauss * h[1], gauss * h[2]});
      for (std::size_t i = first; i < last; ++i) of_plates_[i][n] = values[i - first];
    }
    first = last;
  }
}

void PoissonSolver::add_gaps(int l, std::vector<Gap> const& gaps) {
  if (gaps.empty()) return;
  Level const& level = hierarchy_->level(l);
  Level const* const finer = l + 1 < hierarchy_->level_count() ? &hierarchy_->level(l + 1) : nullptr;
  std::map<std::pair<LocalIndex, int>, std::size_t> wall_faces;
  for (std::size_t i = 0; i < walls_[l].faces.size(); ++i)
    if (auto const& face = walls_[l].faces[i]; face.kind == Boundary::dirichlet)
      wall_faces[{face.row, 2 * face.axis + face.side}] = i;
  for (Gap const& gap : gaps) {
    Real const h = level.spacing()[gap.axis];
    Real const capacitance = vacuum_permittivity * given_->level(l).cell_volume() / (h * h * gap.width);
    std::array<Index3, 2> cell{gap.cell, gap.cell};
    ++cell[1][gap.axis];
    std::array<int, 2> box{-1, -1};
    bool counts = true;  // on this level, and not behind a wall
    for (std::size_t s = 0; s < 2; ++s) {
      Index3 const in_domain = level.wrapped(cell[s]);
      bool const is_behind_wall = !level.domain().contains(in_domain);
      counts = counts && is_behind_wall == (gap.electrode[s] < 0);
      if (is_behind_wall) continue;
      box[s] = level.find(in_domain);
      counts = counts && !(finer && finer->find(first_child_of(in_domain)) >= 0);
    }
    for (std::size_t s = 0; counts && s < 2; ++s) {
      // Of a face between levels the finer cell has both sides. Behind a periodic face are images.
      std::size_t const own = box[s] >= 0 ? s : 1 - s;
      int const b = box[own];
      bool const is_local = b >= level.first_local_box() && b < level.last_local_box();
      if (gap.electrode[s] < 0 || !is_local || !level.domain().contains(cell[own])) continue;
      GapSide side{l,
                   std::size_t(level.local_offset(b) + LocalIndex(level.box(b).offset(cell[own]))),
                   gap.electrode[s],
                   gap.electrode[1 - s],
                   0,
                   capacitance,
                   gap.width};
      if (side.other < 0) {
        auto const face = wall_faces.find({LocalIndex(side.place), 2 * gap.axis + 1 - int(s)});
        if (face == wall_faces.end()) continue;
        side.face = face->second, side.moment /= wall_arm;
      } else if (box[0] < 0 || box[1] < 0) {
        side.moment = 0;  // both are in one cell
      }
      gap_sides_.push_back(side);
    }
  }
}

/// Call f(side of a gap, its charge in C). Local.
template <class F>
void PoissonSolver::for_each_charge_in_gaps(F&& f) const {
  for (GapSide const& side : gap_sides_) {
    Real const other = side.other < 0 ? walls_[side.level].datum[side.face] : potentials_[std::size_t(side.other)];
    f(side, side.capacitance * (potentials_[std::size_t(side.electrode)] - other));
  }
}

std::vector<Real> PoissonSolver::charges(Field const& phi, Field const& rho) {
  std::vector<Real> out(potentials_.size());
  backend_->for_each_charge(phi, rho, [&](int, std::size_t, int on, Real charge) { out[std::size_t(on)] += charge; });
  backend_->for_each_charge_within(rho, [&](int on, Real charge) { out[std::size_t(on)] -= charge; });
  for_each_charge_in_gaps([&](GapSide const& side, Real charge) { out[std::size_t(side.electrode)] += charge; });
  hierarchy_->comm().sum_each(out);
  return out;
}

std::vector<Real> PoissonSolver::sights() {
  std::vector<Real> out(potentials_.size(), -1);
  backend_->for_each_sight([&](int of, Real weight) { out[std::size_t(of)] = std::max(out[std::size_t(of)], weight); });
  for (GapSide const& side : gap_sides_) out[std::size_t(side.electrode)] = 1;
  hierarchy_->comm().largest_each(out);
  return out;
}

/// The potential at open faces of the charge on electrodes in free space, V. Collective.
std::vector<Real> PoissonSolver::of_induced_charge(Field const& phi, Field const& rho) {
  Field density(given_);
  backend_->for_each_charge(phi, rho, [&](int l, std::size_t place, int, Real charge) {
    density.level(l)[place] += charge / given_->level(l).cell_volume();
  });
  for_each_charge_in_gaps([&](GapSide const& side, Real charge) {
    density.level(side.level)[side.place] += side.moment * charge / given_->level(side.level).cell_volume();
  });
  auto const& options = reusable_.free_space->options();
  auto const charges = freespace::charges_of(density, *hierarchy_, 1 / vacuum_permittivity, options);
  auto const values = reusable_.free_space->walls(*wall_plan_, charges, freespace::Which::all);
  std::vector<Real> out;
  for (OpenFace const& open : open_faces_) out.push_back(values[open.places[0]]);
  return out;
}

/// Let open faces see the charge on electrodes, beside all other, as it is after a cycle. Collective.
void PoissonSolver::update_induced_charge(Field const& phi, Field const& rho) {
  auto const value = of_induced_charge(phi, rho);
  of_induced_.resize(value.size());
  induced_change_ = fixed_point_.next(of_induced_, value, hierarchy_->comm());
  show_induced_charge();
}

void PoissonSolver::show_induced_charge() {
  for (std::size_t i = 0; i < of_induced_.size(); ++i)
    walls_[open_faces_[i].level].datum[open_faces_[i].face] = of_charge_[i] + of_induced_[i];
  backend_->walls_changed();
}

void PoissonSolver::set_open_walls(Field const& rho, freespace::Which which) {
  auto charges = freespace::charges_of(rho, *hierarchy_, 1 / vacuum_permittivity, reusable_.free_space->options());
  auto box = charges.begin();
  for (auto& level : backend_->beside_coarse_faces(rho))
    for (auto& of_box : level) {
      for (auto& [cells, density] : of_box) box->added.push_back({{cells.lower, cells.upper}, std::move(density)});
      ++box;
    }
  for (std::size_t b = 0; b < wall_charges_.size(); ++b)
    charges[b].added.insert(charges[b].added.end(), wall_charges_[b].begin(), wall_charges_[b].end());
  auto const values = reusable_.free_space->walls(*wall_plan_, charges, which);
  of_charge_.resize(open_faces_.size());
  for (std::size_t i = 0; i < open_faces_.size(); ++i) {
    auto const& [level, face, places] = open_faces_[i];
    auto const value = [&, &places = places](std::size_t n) {
      return values[places[n]] + (of_plates_.empty() ? 0 : of_plates_[i][n]);
    };
    walls_[level].datum[face] = value(0);
    if (options_.order == 4) walls_[level].second[face] = value(1);
    of_charge_[i] = value(0);
  }
}

/// Of the domain in the solver's coordinates, m^3.
Real PoissonSolver::volume() const {
  Real out = 1;
  for (int d = 0; d < 3; ++d) out *= hierarchy_->domain().upper[d] - hierarchy_->domain().lower[d];
  return out;
}

/// Where constants are in the null space, only a right-hand side without mean has a solution; where screening holds
/// them, that mean is kappa^2 times the one of phi. What cancelled in rho is at least `deposited` (C).
PoissonSolver::Removed PoissonSolver::remove_net_charge(Field const& rho, Real deposited) {
  constexpr Real balanced = 1e-10;  // fraction of all charge that sums over many cells and particles may miss
  constexpr Real last_digits = 4 * std::numeric_limits<Real>::epsilon();
  Real const volume = this->volume();
  Real const stretched_volume = options_.stretch[0] * options_.stretch[1] * options_.stretch[2];
  auto const [net, left] = backend_->integrate_right_hand_side();
  Real const magnitude = std::max(left, deposited / vacuum_permittivity * stretched_volume);
  Real const mean = net / volume;
  Real rounding = last_digits * magnitude / volume;
  if (options_.screening == 0 && !options_.neutralize && std::abs(net) > balanced * magnitude) {
    rounding = std::max(rounding, rounding_of_subtraction(rho) / vacuum_permittivity);
    if (std::abs(mean) > rounding) {
      throw SolverError("all faces are periodic or Neumann, but the net charge (with the flux through the walls) is " +
                        scientific(-net / stretched_volume * vacuum_permittivity) +
                        " C, which no potential can balance; make it zero, ask for background = \"neutralizing\", or "
                        "give one face a potential");
    }
  }
  // Twice: what rounding leaves of a large uniform background is a mean that no potential can balance, and it would
  // stop the residual where little else remains, as between two swings of a plasma.
  backend_->take_away({mean, 0});
  backend_->take_away({mean, backend_->integrate_right_hand_side().net / volume});
  return {mean, rounding};
}

/// Whether all values on all ranks are finite. Collective.
bool PoissonSolver::is_finite(Field const& phi) const {
  bool bad = false;
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    for (Real v : phi.level(l)) bad = bad || !std::isfinite(v);
  return !hierarchy_->comm().any(bad);
}

/// Whether the mean of phi is found apart from the cycles.
bool PoissonSolver::leaves_mean() const {
  return !metal_ && is_mean_left_free(hierarchy_->level(0), hierarchy_->domain().boundary, shift_of(options_));
}

/// Refuse a right-hand side so small or large that the potential and its differences would leave the range of double
/// precision.
void PoissonSolver::check_size(Real largest) const {
  if (!std::isfinite(largest))
    throw SolverError(
        "the charge density or the boundary data hold values that are not finite; look for the step that made them");
  constexpr Real least = 1e-290, most = 1e290;
  Real3 const& h = hierarchy_->level(hierarchy_->level_count() - 1).spacing();
  Real const finest = std::min({h[0], h[1], h[2]});
  Real widest = 0;
  for (int d = 0; d < 3; ++d) widest = std::max(widest, hierarchy_->domain().upper[d] - hierarchy_->domain().lower[d]);
  Real const in_cell = largest * std::min(Real(1), finest * finest);
  Real const in_all = largest * std::max({Real(1), widest * widest, widest / finest * (widest / finest)});
  if (largest != 0 && (in_cell < least || in_all > most))
    throw SolverError("the right-hand side is of the order of " + scientific(largest) + " V/m^2, which is too " +
                      (in_cell < least ? "small" : "large") +
                      " for double precision to hold the potential; scale the charge and the boundary data");
}

/// The residual that rounding leaves, in the norm of the residual.
///
/// With u = epsilon / 2, a potential is stored to u |phi|, and so is each of the three sums of neighbours, times 2 /
/// h_d^2; then the sums of sums and of the diagonal term are rounded. All these are some u D |phi|, D = sum_d 2 / h_d^2
/// being the diagonal, and independent of each other: as uniform numbers they add up to a root mean square of 0.4
/// epsilon D |phi|, and to a largest of some thousand cells of 1.5 epsilon D |phi|. Fluxes through coarse-fine faces
/// are sums of like terms. f itself is the same number in every cycle and adds nothing: what cancels in it is rounded
/// once and for all.
Real PoissonSolver::rounding_floor() const {
  return std::numeric_limits<Real>::epsilon() * backend_->largest_phi_term();
}

/// Give phi its mean, which screening alone holds: that of f over kappa^2. Rounded, its values then leave a residual
/// that no cycle reduces.
void PoissonSolver::add_mean(SolveReport& report, Field& phi, Real of_right_hand_side, Real largest) const {
  Real const shift = shift_of(options_), mean = -of_right_hand_side / shift;
  backend_->set_mean(phi, mean);
  Real const size = std::max(std::abs(of_right_hand_side), largest);
  if (size == 0) return;
  Equation const finest = equation_on(hierarchy_->level(hierarchy_->level_count() - 1).spacing(), shift);
  Real const left = std::numeric_limits<Real>::epsilon() * finest.diagonal() * std::abs(mean) / size;
  if (left <= std::max(options_.tolerance, report.floor)) return;
  report.floor = left;
  std::string const of_mean =
      "rounding the mean of phi, which screening alone holds, leaves " + scientific(left) + " of the right-hand side";
  report.reason += "; " + of_mean;
  if (left <= 1) return;
  report.converged = false;
  report.reason = of_mean + ": it is too large for double precision to hold differences between neighbours";
}

/// `largest`: magnitude of f; `rounding`: see Removed.
void PoissonSolver::iterate(SolveReport& report, Field const& rho, Field& phi, bool from_zero, Real largest,
                            Real rounding) {
  auto finish = [&](bool converged, std::string reason) {
    report.converged = converged;
    report.reason = std::move(reason);
  };
  auto start_from_zero = [&] {
    for (int l = 0; l < hierarchy_->level_count(); ++l) std::fill(phi.level(l).begin(), phi.level(l).end(), 0.0);
    backend_->start(phi, true);
  };
  if (largest <= rounding) {
    start_from_zero();
    report.residuals.push_back(0);
    return finish(true, options_.screening > 0 && rounding > 0
                            ? "the charge is uniform to rounding, and so is the potential"
                        : largest == 0 ? "the right-hand side is zero"
                                       : "the charge is uniform to rounding, so the potential is zero");
  }
  check_size(largest);
  Real const size = backend_->right_hand_side_norm();
  bool const goes_by_known = !from_zero && report.mesh_error.holds_for(size);
  if (goes_by_known)
    ++report.mesh_error.solves;
  else
    report.mesh_error = {};
  backend_->start(phi, from_zero);
  constexpr int updates =
      2;  // cycles after which open faces see the charge that these left on electrodes; one is too few
  constexpr Real hopeless = 1e10;  // residual of a guess that is of another order of magnitude than the answer
  // Cycles in a row that hardly moved the residual; since it was last well below all before; and that lowest one.
  int stuck = 0, since_lowest = 0;
  Real lowest = std::numeric_limits<Real>::infinity();
  bool const holds_mean = options_.screening > 0 && leaves_mean();  // by the shift, to which no cycle answers
  for (;; ++report.cycles) {
    if (holds_mean && !(from_zero && report.cycles == 0)) backend_->set_mean(phi, 0);
    Real residual = backend_->residual() / size;
    if (report.cycles == 0 && !from_zero && !(residual <= hopeless)) {
      if (!is_finite(phi)) throw SolverError("the guess holds values that are not finite; solve without one");
      start_from_zero();  // which is the better guess
      residual = backend_->residual() / size;
    }
    report.residuals.push_back(residual);
    if (!(induced_change_ > std::max(options_.tolerance, residual))) {
      if (residual <= options_.tolerance) return finish(true, "tolerance reached");
      if (residual * size <= options_.absolute_tolerance) return finish(true, "absolute tolerance reached");
    }
    if (!std::isfinite(residual)) return finish(false, "the residual is not finite");
    // Of a potential that little holds, what corrections in single precision round is that large at first.
    if (residual > 1e6 * std::max(report.residuals.front(), Real(1)) && residual > 1e10 * rounding_floor() / size)
      return finish(false, "the cycles diverge");
    if (options_.to_discretisation && report.cycles > (goes_by_known ? 0 : 1) && below_discretisation(report, size))
      return finish(true, "error left is below a tenth of the estimated " + scientific(report.mesh_error.error) +
                              " V of the mesh");
    if (report.cycles > 0) {
      Real const factor = residual / report.residuals[report.residuals.size() - 2];
      stuck = factor > 0.98 ? stuck + 1 : 0;
      if (report.cycles > 2 && !options_.to_discretisation && is_slow(report.residuals)) backend_->accelerate();
    }
    since_lowest = residual < 0.8 * lowest ? 0 : since_lowest + 1;
    if (since_lowest == 0) lowest = residual;
    // A residual that still falls, however slowly, may reach a tolerance near the floor.
    if (since_lowest >= 2) {
      // Where coarse cells border on fine long ones, rows have larger terms than those that the estimate knows.
      Real const floor = rounding_floor() / size, above = since_lowest >= 6 ? 100 : 10;
      if (residual <= above * floor) {
        report.floor = floor;
        if (floor > 1)
          return finish(false,
                        "rounding alone leaves " + scientific(floor) +
                            " of the right-hand side: the walls hold the potential too weakly for double precision");
        return finish(true, "rounding floor of about " + scientific(floor) + " reached");
      }
    }
    if (stuck >= 5) return finish(false, "the residual no longer falls");
    if (report.cycles == options_.max_cycles)
      return finish(false, "no convergence in " + std::to_string(options_.max_cycles) + " cycles");
    backend_->improve();
    if (sees_metal() && report.cycles % updates == updates - 1)
      stopwatch_.time("open boundary", [&] { update_induced_charge(phi, rho); });
    if (options_.to_discretisation) {
      correction_before_ = report.cycles > 0 ? latest_correction_ : std::numeric_limits<Real>::infinity();
      latest_correction_ = backend_->largest_correction();
    }
  }
}

/// Whether so many cycles, and those to come at the pace of the latest one, are more than nine for ten digits, eleven
/// where cells are long, or seven beside metal on a single level, as its holes may be closed on coarse ones, and cycles
/// over refined levels are more in any case; in fourth order four more, or eight with Dirichlet walls. Where the
/// factors of corrections differ, the pace is that of all of them in turn, and not known before.
bool PoissonSolver::is_slow(std::vector<Real> const& residuals) const {
  Real const residual = residuals.back();
  std::size_t const cycles = residuals.size() - 1, back = backend_->steps_in_turn();
  if (cycles < back) return false;
  Real const factor = std::pow(residual / residuals[cycles - back], Real(1) / Real(back));
  if (factor >= 1) return true;
  Real const tolerance = std::clamp(options_.tolerance, 1e-10, 0.1);
  Real most = has_long_cells(hierarchy_->level(0)) ? 11 : metal_ && hierarchy_->level_count() == 1 ? 7 : 9;
  if (options_.order == 4) most += hierarchy_->domain().has(Boundary::dirichlet) ? 8 : 4;
  return Real(cycles) + std::log(tolerance / residual) / std::log(factor) > most * std::log10(1 / tolerance) / 10;
}

/// Whether what the cycles to come would still change is a tenth of the error of the mesh: the latest correction times
/// the sum of the geometric series that they make.
bool PoissonSolver::below_discretisation(SolveReport& report, Real right_hand_side) {
  MeshError& mesh = report.mesh_error;
  if (report.cycles == 2) mesh.contraction = latest_correction_ / correction_before_;
  if (mesh.error == 0) {
    stopwatch_.time("discretisation error", [&] { mesh.error = backend_->discretisation_error(); });
    mesh.right_hand_side = right_hand_side;
  }
  Real const residual = report.residuals.back(), before = report.residuals[report.residuals.size() - 2];
  // What a first cycle leaves is what the second one changed when there was one, to be taken twice; of further ones the
  // residual may fall faster than the error at first, and no cycle gains more than a digit for good.
  Real const pace =
      report.cycles == 1 ? 2 * mesh.contraction : std::max(latest_correction_ / correction_before_, Real(0.1));
  Real const factor = std::max(residual / before, pace);
  return factor < 0.9 && latest_correction_ * factor / (1 - factor) <= 0.1 * mesh.error;
}

SolveReport PoissonSolver::solve(Field const& rho, Field& phi, bool from_zero, MeshError const& known, Real deposited,
                                 bool images) {
  SolveReport report;
  report.mesh_error = known;
  stopwatch_.reset();
  backend_->stopwatch().reset();
  using freespace::Which;
  Which const which = options_.across.axis < 0 ? Which::all : images ? Which::against : Which::with;
  if (wall_plan_) stopwatch_.time("open boundary", [&] { set_open_walls(rho, which); });
  if (sees_metal()) {
    fixed_point_.clear();
    of_induced_.clear();
    induced_change_ = 0;
    if (!from_zero) {
      stopwatch_.time("open boundary", [&] {
        of_induced_ = of_induced_charge(phi, rho);
        show_induced_charge();
      });
    }
  }
  std::optional<Field> nothing;
  if (images) nothing.emplace(rho.share_hierarchy());
  backend_->set_right_hand_side(images ? *nothing : rho);
  Removed removed{0, 0};
  if (leaves_mean()) removed = remove_net_charge(rho, deposited);
  Real const largest = backend_->largest_right_hand_side();
  iterate(report, rho, phi, from_zero, largest, removed.rounding);
  backend_->finish();
  if (leaves_mean()) options_.screening > 0 ? add_mean(report, phi, removed.mean, largest) : backend_->set_mean(phi, 0);
  report.seconds = stopwatch_.seconds();
  for (auto const& [stage, seconds] : backend_->stopwatch().seconds()) report.seconds[stage] = seconds;
  return report;
}

}  // namespace amrpic
