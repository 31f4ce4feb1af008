#pragma once

#include <functional>
#include <memory>
#include <set>

#include "base/communicator.hpp"
#include "cycle/layout.hpp"
#include "cycle/relays.hpp"
#include "mesh/exchange.hpp"

namespace amrpic::cycle {

/// Some cells of one own box of a level, and where a copy of them belongs.
struct Copied {
  int box;    ///< number of the box on the level
  Box cells;  ///< in the indices of that box
  Placement copy;
};

/// Call f(part, where it lies) for the parts of a box that lie in rectangles of memory.
using VisitPart = std::function<void(Box const&, Placement const&)>;
using ForEachPart = std::function<void(Box const&, VisitPart const&)>;

/// Which cells pass between ranks: all, or those of one colour, the parity of the sum of their indices.
enum class Colours { first, second, all };

/// The plan by which copies of cells are updated from the cells, whichever rank owns these, and are added to them. All
/// that passes between two ranks in a call is one message. Where all cells are in this rank's memory there is none.
class RectangleExchange {
 public:
  RectangleExchange() = default;

  /// `layout` holds the cells. `local`: what is copied from own boxes. `across`: what passes between ranks;
  /// a cell of it, in the indices of the copy, may have several copies or none. Of one colour, only `update` is for it,
  /// and copies of own cells take both. With `routes`, see `plan_relays`, what a rank would send to many ranks
  /// passes through some of them; then, too, only `update` is for it.
  RectangleExchange(Communicator const& comm, Layout const& layout, std::vector<Copied> const& local,
                    CopiesAcrossRanks const& across, ForEachPart const& copies, Colours colours = Colours::all,
                    Routes const& routes = {});

  /// Fill the copies, which may lie in the vector of the cells. Collective.
  void update(float const* cells, float* copies) const {
    start(cells, copies);
    finish(copies);
    settle();
  }
  /// The same in the steps of an Exchange.
  void start(float const* cells, float* copies) const;
  void poll() const { exchange_.poll(); }
  void finish(float* copies) const;
  void settle() const { exchange_.settle(); }

  /// Add the copies to the cells. Collective.
  void add(float const* copies, float* cells) const;

  /// The plan cell by cell and without relays, for those who copy elsewhere.
  struct Lists {
    using Pairs = std::vector<std::pair<std::int32_t, std::int32_t>>;
    Pairs local;   ///< places of a cell and of its copy
    Pairs asked;   ///< places of a cell and in the message, all messages being one after the other
    Pairs wanted;  ///< places of a copy and in the message
    std::vector<Parcel> asked_parcels, wanted_parcels;
  };
  Lists lists() const;

  std::set<int> const& neighbours() const { return neighbours_; }  ///< ranks that this one exchanges values with

 private:
  /// Cells of this rank and a copy of them, both in rectangles of memory.
  struct Pair {
    Index3 extent;
    Placement at, copy;
  };
  /// What passes, rectangle by rectangle: of small boxes there are thousands.
  struct Packed {
    struct Part {
      Index3 extent, first;  ///< the latter from the rectangle's first cell
      Placement at;          ///< in memory
    };
    struct Rectangle {
      int first_part, parts;
      Index3 extent;
      int parity;     ///< of the cells that pass, counted from the first one
      Parcel parcel;  ///< what of it passes
    };
    std::vector<Rectangle> rectangles;
    std::vector<Part> parts;
  };
  Packed packed(std::vector<CopiedRectangle> const& rectangles, bool shifted, ForEachPart const& for_each_part) const;
  /// Call f(part, where it lies in the message) for the parts of a rectangle.
  template <class F>
  static void for_each_part_of(Packed const& packed, std::size_t n, F&& f);
  std::int64_t places(Box const& cells) const;
  void plan_with_relays(Communicator const& comm, CopiesAcrossRanks const& across, Routes const& routes);
  std::vector<Parcel> parcels(std::vector<CopiedRectangle> const& rectangles);
  void unpack(std::size_t n, float const* in, float* copies) const;

  /// What passes through other ranks, and through this one.
  struct Relays {
    RelayPlan plan;
    Exchange<float> second_round;
    std::vector<std::size_t> first;  ///< of what is passed on: places in `values`, and their number
    std::vector<float> values;
  };

  Colours colours_ = Colours::all;
  std::set<int> neighbours_;
  std::vector<Pair> local_;
  Packed asked_, wanted_;
  Exchange<float> exchange_;
  std::unique_ptr<Relays> relays_;  ///< none where all pass directly
};

}  // namespace amrpic::cycle
