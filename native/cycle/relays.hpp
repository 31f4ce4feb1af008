// Whoever sends values to many ranks sends them to some of these, which pass on what is for others.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <vector>

#include "cycle/copies_across_ranks.hpp"

namespace amrpic::cycle {

/// So many ranks get what they read of a rank from itself, unless an option gives another number, the same on all
/// ranks; of more, some pass it on.
constexpr int most_direct_readers = 32;  // neighbours on a level are 26

/// The rank that sends each reader what it reads of an owner: the reader itself where it comes from the owner.
/// `values`: how many each reads. Of n readers, the √n that read most pass on what the others read, which they share
/// evenly.
std::map<int, int> relays_of(std::map<int, std::int64_t> const& values, int most_direct);

/// Rectangles on their way between owners and readers, in two rounds: from owners to readers and relays, and from
/// relays to other readers. Those of two ranks are in the same order on both.
struct RelayPlan {
  struct Step {
    int rank;  ///< where it goes, or comes from
    int own;   ///< number among what others read of this rank (first round), or among what it reads; -1 if it is passed
               ///< on
    int passed_on;  ///< number among what is passed on, or -1
  };
  std::vector<Step> sent_first, received_first, sent_second, received_second;  ///< in ascending order of ranks
  std::vector<Box> passed_on;                                                  ///< cells of what this rank passes on
};

/// What all others read of a rank, as that one has it, and by which rank each rectangle passes.
struct RoutedReads {
  RoutedReads(std::vector<CopiedRectangle> of_all, int most_direct);

  std::vector<CopiedRectangle> asked;
  std::map<int, int> relays;                   ///< of each reader, see `relays_of`
  std::map<int, std::vector<int>> of_reader;   ///< numbers of what it reads, ascending
  std::map<int, std::vector<int>> sent_first;  ///< of what readers and relays get from the rank itself
};

/// How what many ranks may read passes.
struct Routes {
  int most_direct;                                                  ///< see `most_direct_readers`
  std::function<std::shared_ptr<RoutedReads const>(int owner)> of;  ///< null: all passes directly
};

/// Those found so far, by rank: for the plans of many ranks in turn, which read of the same ones.
using KnownReads = std::map<int, std::shared_ptr<RoutedReads const>>;

/// The plan of rank `me`. Local.
RelayPlan plan_relays(int me, CopiesAcrossRanks const& across, Routes const& routes);

}  // namespace amrpic::cycle
