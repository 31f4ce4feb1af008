#pragma once

#include <vector>

#include "mesh/exchange.hpp"
#include "mesh/rim.hpp"
#include "particle/shell.hpp"

namespace amrpic {

class BufferZone;
class ParticleMesh;

/// Where gather finds the field around each box of this rank: what a ParticleMesh tells of places among all cells of a
/// level, for values that are kept at rims alone.
class RimPlaces {
 public:
  /// What lies around one box, as in BoxGhosts; and as in BoxBuffer, for each of its levels.
  struct Around {
    Shell shell;
    std::vector<LocalIndex> coarse;
    std::vector<std::vector<LocalIndex>> matched;
  };

  /// `zone`: what matched clouds touch as well; null without them.
  RimPlaces(ParticleMesh const& mesh, BufferZone const* zone);

  Around const& around(std::size_t slot) const { return around_[slot]; }
  Exchange const& exchange(int level) const { return exchanges_[std::size_t(level)]; }
  Exchange const& exchange_of_matched(int level) const { return of_matched_[std::size_t(level)]; }

 private:
  std::vector<Around> around_;
  std::vector<Exchange> exchanges_, of_matched_;
};

}  // namespace amrpic
