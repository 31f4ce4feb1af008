#pragma once

#include <vector>

#include "base/large_array.hpp"
#include "mesh/halo.hpp"

namespace amrpic {

/// The cells of a level that a rank's particles charge: its own ones, and the halo.
struct ChargeCells {
  Real *own, *halo;
  LocalIndex owned;
  Real& operator[](LocalIndex place) const { return place < owned ? own[place] : halo[place - owned]; }
};

/// Charge that this rank's particles leave on cells of other ranks, on its way to their owners.
class ChargeAcrossRanks {
 public:
  ChargeAcrossRanks(Halo const& halo, LargeArray<Real>& own)
      : halo_(&halo), own_(own.data()), values_(std::size_t(halo.size()), Real(0)) {}

  ChargeCells cells() { return {own_, values_.data(), halo_->owned()}; }

  /// Add it to what the owners have. Collective.
  void send() const { halo_->fold({own_}, {values_.data()}); }

 private:
  Halo const* halo_;
  Real* own_;
  std::vector<Real> values_;
};

}  // namespace amrpic
