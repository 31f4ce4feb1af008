#pragma once

#include <algorithm>
#include <array>
#include <memory>

#include "base/communicator.hpp"
#include "cycle/rectangle_exchange.hpp"
#include "cycle/sweep.hpp"
#include "multigrid/nearly_free.hpp"

namespace amrpic::cycle {

/// How often and how strongly the cycle relaxes.
struct Relaxation {
  int pre_sweeps = 2, post_sweeps = 2;
  Real factor = 1.25;

  /// Of deep copies: each half-sweep reads one cell further. Where there is metal, others may come before.
  int halo(bool has_metal) const { return 2 * (std::max(pre_sweeps, post_sweeps) + has_metal); }
};

/// Which cells sweeps relax.
enum class Relaxed { all, beside_metal };

/// One of the halves of sweeps after each other.
struct HalfSweep {
  HalfSweep(int number, bool from_zero)
      : colour(number % 2),
        is_fresh(from_zero && number == 0),
        reads(is_fresh ? 0 : colour_bit(1 - colour)),
        changes(is_fresh ? both_colours : colour_bit(colour)) {}
  int colour;
  bool is_fresh;       ///< sets all corrections
  int reads, changes;  ///< colours
};

/// Sweeps over a level, and the cells that they relax on a rank, both colours being one.
struct SweepWork {
  std::int64_t sweeps = 0;
  Real relaxed = 0;
};

/// A level with corrections e and right-hand sides r in single precision, r = h² (residual) for the smallest spacing h
/// of the level, and all that sweeps over it need.
class SweptLevel {
 public:
  using MetalIn = std::function<MetalCells(std::vector<Box> const&)>;
  /// `shift`: of the Equation; `halo`: how deep the copies of other ranks' cells are. With deep ones all ranks sweep
  /// over them too, and messages are few; those of one layer are brought before each half of a sweep, which takes a
  /// fraction of the bytes and no work beside that on own cells. `boundary`: of the domain; `metal`: in boxes, null if
  /// there is none. Collective.
  SweptLevel(Communicator const& comm, std::shared_ptr<Level const> level, GhostRules const& rules,
             Faces const& boundary, Real shift, Relaxation const& relaxation, int halo, MetalIn const& metal = nullptr);
  SweptLevel(SweptLevel const&) = delete;  // the sweeps refer to the layout
  SweptLevel& operator=(SweptLevel const&) = delete;

  // Acts are put off, until values are read, and then run in one pass over all planes.
  /// Sweeps over both colours. `further`: how many cells outside own ones their result is read.
  void relax(int sweeps, bool from_zero, int further) { relax(Relaxed::all, sweeps, from_zero, further); }
  /// A sweep over the cells beside metal, if there may be metal on any rank.
  void relax_beside_metal(int further) {
    if (may_have_metal_) relax(Relaxed::beside_metal, 1, false, further);
  }
  bool may_have_metal() const { return may_have_metal_; }
  /// What comes next is done to each plane.
  void then(PlaneStage stage) { stages_.push_back(std::move(stage)); }
  /// Run all that was put off; where copies are still under way, wait for them when they are reached. Collective.
  void run();
  /// The same after the last stage of a cycle, if there is one.
  void finish() {
    if (last_.act) then(last_);
    run();
  }
  /// What is done last to each plane of own cells in a cycle.
  void set_last_stage(PlaneStage stage) { last_ = std::move(stage); }

  /// Say that corrections of all own cells have been set.
  void corrections_are_new() { stale_ = both_colours; }

  /// Whether parts of the level are copies, which other ranks or the other end of the domain must fill.
  bool has_halo() const { return level_->ranks() > 1 || layout_.has_halo(); }
  /// Whether a periodic axis has an odd number of cells, so that two of one colour meet.
  bool has_odd_ring() const {
    for (int d = 0; d < 3; ++d)
      if (level_->periodic()[d] && level_->domain().extent(d) % 2 != 0) return true;
    return false;
  }
  /// Whether copies are one layer of cells, which are brought when stages need them, and none of right-hand sides.
  bool is_thin() const { return is_thin_; }
  /// Begin to bring the copies of right-hand sides up to date; the next `run` waits for them. Collective.
  void exchange_right_hand_sides();
  /// The same for corrections; `boundary_changed`: right-hand sides have changed since then, beside coarser cells
  /// alone. Collective.
  void exchange_corrections(bool boundary_changed);

  /// From now on only count sweeps, adding to `work`, and run no stages; values are exchanged as ever. Null: run them
  /// again.
  void rehearse(SweepWork* work) { rehearsal_ = work; }
  std::set<int> const& neighbours() const { return is_thin_ ? halo_of_colour_[0].neighbours() : halo_.neighbours(); }

  // How copies come: all of them, those of the level's boundary cells, and thin ones by colour.
  RectangleExchange const& halo() const { return halo_; }
  RectangleExchange const& edge_halo() const { return edge_halo_; }
  RectangleExchange const& halo_of_colour(std::size_t colour) const { return halo_of_colour_[colour]; }

  Level const& level() const { return *level_; }
  Layout const& layout() const { return layout_; }
  LevelFaces const& faces() const { return faces_; }  ///< of the layout's blocks
  Stencil const& stencil() const { return stencil_; }
  Sweep const& sweep() const { return sweep_; }
  /// Where an own cell lies in the vectors, and the diagonal of its equation, with what ghosts add to it; 0 in metal.
  struct PlaceAndDiagonal {
    std::size_t place;
    float diagonal;
  };
  PlaceAndDiagonal place_and_diagonal(Index3 const& cell) const;
  Vector& right_hand_side() { return r_; }
  void clear_right_hand_side_in_metal() {
    for (SolidRun const& run : stencil_.solids_in_planes()) std::fill_n(&r_[std::size_t(run.place)], run.count, 0.0f);
  }
  Vector& correction() { return e_; }
  Real scale() const { return scale_; }            ///< h²
  Equation equation() const { return equation_; }  ///< times that

  std::size_t bytes() const { return (r_.size() + e_.size()) * sizeof(float) + stencil_.bytes(); }

 private:
  void relax(Relaxed cells, int sweeps, bool from_zero, int further);
  void begin(RectangleExchange const& plan, Vector& values);
  void begin(int colours);
  void finish_exchanges();
  template <class Rows>
  void pass(PlaneStage const& stage, Rows&& rows);
  void run_one_by_one(std::vector<PlaneStage> const& stages);
  Real relaxed_cells(int sweeps, int further) const;

  std::shared_ptr<Level const> level_;
  Real scale_;
  Equation equation_;
  bool is_thin_, may_have_metal_;
  Layout layout_;
  LevelFaces faces_;
  Stencil stencil_;
  Sweep sweep_;
  Vector r_, e_;
  RectangleExchange halo_, edge_halo_;               ///< all copies, and those of the level's boundary cells
  std::array<RectangleExchange, 2> halo_of_colour_;  ///< of thin copies, in place of both
  int stale_ = both_colours;                         ///< colours of thin copies that are not up to date
  std::vector<std::pair<RectangleExchange const*, Vector*>> under_way_;
  std::vector<PlaneStage> stages_;  ///< put off
  PlaneStage last_;                 ///< may be none
  SweepWork* rehearsal_ = nullptr;
};

}  // namespace amrpic::cycle
