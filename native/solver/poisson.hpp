#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "freespace/image.hpp"
#include "mesh/field.hpp"
#include "solver/backend.hpp"
#include "solver/fixed_point.hpp"
#include "solver/reusable.hpp"
#include "solver/wall_charges.hpp"
#include "stencil/fourth_order.hpp"

namespace amrpic {

/// What a solve to the error of the mesh found, and solves for nearly the same charge on the same mesh go by.
struct MeshError {
  Real error = 0;            ///< estimate of the largest error of phi that the mesh makes, V; 0: not known
  Real contraction = 0;      ///< the largest change of phi by the second cycle over that by the first
  Real right_hand_side = 0;  ///< norm of it then
  int solves = 0;            ///< since then

  static constexpr int lasts = 9;        ///< solves that go by it
  static constexpr Real changes = 1.25;  ///< factor by which the right-hand side may grow or shrink meanwhile
  bool holds_for(Real norm) const {
    return error > 0 && solves < lasts && norm < changes * right_hand_side && changes * norm > right_hand_side;
  }
};

/// How a solve went.
struct SolveReport {
  bool converged = false;
  int cycles = 0;
  std::vector<Real> residuals;  ///< before the first cycle and after each, relative to the right-hand side
  MeshError mesh_error;         ///< unless it was not asked for
  Real floor = 0;               ///< estimate of the relative residual that rounding alone leaves; 0 if not reached
  std::string reason;
  std::map<std::string, Real> seconds;
};

/// A gap between two pieces of metal on the way from the centre of a cell up to that of the next one, with no centre in
/// it. Its flux is that between parallel plates: across surfaces at any angle, the field along an axis is the voltage
/// over the length of the gap along that axis.
struct Gap {
  Index3 cell;
  int axis;
  std::array<int, 2> electrode;  ///< below and above it; -1 for a wall of the domain
  Real width;                    ///< over the spacing
};

/// Solves Laplace phi = -rho / eps0 over all levels of a hierarchy at once. Set up once per hierarchy, solved many
/// times. With options.stretch = s the Laplacian is the sum of (1/s_d^2) d^2/dx_d^2: that of coordinates s_d x_d, in
/// which everything below lives.
class PoissonSolver {
 public:
  /// `reusable`, if any, comes from a solver of the same options; `metal`: null if there are no electrodes. Collective.
  PoissonSolver(std::shared_ptr<Hierarchy const> hierarchy, SolverOptions const& options, Reusable const& reusable,
                std::shared_ptr<Metal const> metal = nullptr);
  PoissonSolver(PoissonSolver const&) = delete;  // the cycle refers to the operators
  PoissonSolver& operator=(PoissonSolver const&) = delete;

  /// The wall faces of a level on this rank; their Dirichlet and Neumann data may be set before a solve.
  Walls& walls(int level) { return walls_[level]; }
  /// The potentials of electrodes, V, zero before; a solve goes by them.
  void set_potentials(std::vector<Real> const& potentials) { potentials_ = potentials; }
  /// Let gaps on lines through the centres of a level's cells count; those of other ranks are skipped. Local.
  void add_gaps(int level, std::vector<Gap> const& gaps);
  /// The charge on each electrode, C, in the potential that a solve for rho left, gaps included. What rho holds in its
  /// cells, the part of clouds that reach into metal, counts as imaged on it. Collective.
  std::vector<Real> charges(Field const& phi, Field const& rho);
  /// How much cells outside metal see of each electrode: the largest weight of its potential in their equations, over
  /// the diagonal; 1 at gaps, and -1 of one that is nowhere on the mesh. Collective.
  std::vector<Real> sights();
  /// Let open faces see the data that walls beside them hold now. Beyond its face a Dirichlet wall is at one of these
  /// potentials (V), wherever it goes on, and a Neumann wall has no slope. Local.
  void continue_walls(freespace::PerFace const& potentials);

  /// Fill phi (V) from rho (C/m^3), starting from what phi holds; `from_zero`: nothing but zeros. Covered cells of phi
  /// hold the mean of their children. `known`: by the solve that found the first guess, on the same mesh. `deposited`:
  /// sum of the magnitudes of the charges whose density rho is, C. Throws SolverError for a charge that no potential
  /// can balance. With options.across, `images` asks for the potential of the images that move against the charge
  /// alone, else it is that of the charge and of the images that move with it. Collective.
  SolveReport solve(Field const& rho, Field& phi, bool from_zero, MeshError const& known = {}, Real deposited = 0,
                    bool images = false);

  /// E, -(1/s_d^2) d phi/dx_d (V/m); walls count with the data of the latest solve. The potential must stay as it is.
  /// Collective.
  ElectricField electric_field(std::shared_ptr<Field const> potential, CoveredField covered) {
    return backend_->electric_field(std::move(potential), covered);
  }

  // Of a solver of order 4; see FourthOrderField. Collective.
  ElectricField electric_field_as(Field const& potential, CoveredField covered, Holds holds) {
    return backend_->electric_field_as(potential, covered, holds);
  }
  void to_means(Field const& points, Field& means) { backend_->to_means(points, means); }

  Hierarchy const& hierarchy() const { return *given_; }
  /// The operators of a level as compressed rows, which are made for this where the backend does without. Collective at
  /// the first call.
  LevelOperators const& operators_with_gradient(int level) { return backend_->operators_with_gradient(level); }

  Reusable const& reusable() const { return reusable_; }
  Backend const& backend() const { return *backend_; }

 private:
  void plan_open_walls();
  void set_open_walls(Field const& rho, freespace::Which which);
  std::vector<Real> of_induced_charge(Field const& phi, Field const& rho);
  void update_induced_charge(Field const& phi, Field const& rho);
  void show_induced_charge();
  template <class F>
  void for_each_charge_in_gaps(F&& f) const;
  struct Removed {
    Real mean;      ///< of f
    Real rounding;  ///< how large what is left may be by the rounding of what cancelled in it alone
  };
  Removed remove_net_charge(Field const& rho, Real deposited);
  Real volume() const;
  bool is_finite(Field const& phi) const;
  bool leaves_mean() const;
  bool sees_metal() const { return metal_ && wall_plan_; }
  Real rounding_floor() const;
  void check_size(Real right_hand_side) const;
  void iterate(SolveReport& report, Field const& rho, Field& phi, bool from_zero, Real largest, Real rounding);
  void add_mean(SolveReport& report, Field& phi, Real of_right_hand_side, Real largest) const;
  bool is_slow(std::vector<Real> const& residuals) const;
  bool below_discretisation(SolveReport& report, Real right_hand_side);

  std::shared_ptr<Hierarchy const> given_;
  /// The given one in stretched coordinates, open where walls lie across the motion of charge.
  std::shared_ptr<Hierarchy const> hierarchy_;
  SolverOptions options_;
  Reusable reusable_;
  std::vector<Walls> walls_;
  std::shared_ptr<Metal const> metal_;
  std::vector<Real> potentials_;
  /// An electrode's side of a gap.
  struct GapSide {
    int level;
    std::size_t place;  ///< of a cell in fields of the level
    int electrode;
    int other;         ///< electrode across the gap; -1: a wall
    std::size_t face;  ///< of the wall
    Real capacitance;  ///< F
    Real moment;       ///< share of the charge that has its dipole moment with the other side's, from centre to centre
  };
  std::vector<GapSide> gap_sides_;
  // Potentials at open faces, V: of the charge on electrodes, and of all other.
  std::vector<Real> of_induced_, of_charge_;
  FixedPoint fixed_point_;
  Real induced_change_ = 0;  ///< of what open faces see of electrodes by the latest cycle, relative
  struct OpenFace {
    int level;
    std::size_t face;  ///< of the level's walls
    std::array<std::size_t, fourth_order::ghost_layers>
        places;  ///< of its ghosts' potentials among those of free space
  };
  std::vector<OpenFace> open_faces_;
  freespace::PerFace plates_{};                                          ///< potentials of walls beyond their faces
  std::vector<std::array<Real, fourth_order::ghost_layers>> of_plates_;  ///< by open face, V; none if zero
  std::vector<std::vector<freespace::ChargeBox::Added>> wall_charges_;   ///< by box; none if zero
  std::shared_ptr<freespace::WallPlan const> wall_plan_;                 ///< where walls are open
  std::unique_ptr<Backend> backend_;
  Stopwatch stopwatch_;
  Real latest_correction_ = 0, correction_before_ = 0;  ///< largest change of phi by the latest two cycles, V
};

}  // namespace amrpic
