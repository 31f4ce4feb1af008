#include <algorithm>
#include <numeric>

#include "gmls/batch.hpp"

namespace amrpic::gmls {

namespace {

constexpr std::size_t sorted_together = 4096;  ///< targets, so that lanes of about equal numbers of neighbours meet

/// A residual that no rounding explains: the samples do not determine what is wanted.
constexpr Real far_from_reproduced = 1e-4;

/// Whether the normal equations gave a stencil that can be used.
class Judge {
 public:
  Judge(Problem const& problem, Real residual_bound, Real sum_bound, Stencils const& to)
      : problem_(problem), residual_bound_(residual_bound), sum_bound_(sum_bound), to_(to) {}

  bool is_good(std::size_t target) const {
    return to_.residual[target] <= residual_bound_ && to_.sum[target] <= sum_bound_;
  }
  /// Try anew what did not determine its result, and say so where that fails too.
  void repair(std::size_t target, Batch<Real>& single) const {
    if (to_.path[target] == Path::dependent) return;
    if (problem_.neighbours(target) > 0) {
      Path const path = to_.path[target];
      if (path != Path::undetermined && is_good(target)) return;
      if (path == Path::less_rank && to_.residual[target] > far_from_reproduced)
        return void(to_.path[target] = Path::undetermined);
      single.solve_by_factors({target}, to_);
      if (is_good(target)) return;
    } else {
      to_.pivot[target] = 0;
      to_.residual[target] = 1;
      to_.sum[target] = 0;
    }
    to_.path[target] = Path::undetermined;
  }

 private:
  Problem const& problem_;
  Real residual_bound_, sum_bound_;
  Stencils const& to_;
};

}  // namespace

void solve(Problem const& problem, Real residual_bound, Real sum_bound, bool portable, Stencils const& to) {
  Judge const judge(problem, residual_bound, sum_bound, to);
  Batch<Real> single(problem);
  for (std::size_t target = 0; portable && target < problem.count; ++target) {
    to.path[target] = Path::undetermined;
    if (problem.neighbours(target) > 0) single.solve({target}, to);
    judge.repair(target, single);
  }
  if (portable) return;
  Batch<ProcessorLanes> batch(problem);
  std::vector<std::size_t> order;
  for (std::size_t first = 0; first < problem.count; first += sorted_together) {
    std::size_t const last = std::min(problem.count, first + sorted_together);
    order.resize(last - first);
    std::iota(order.begin(), order.end(), first);
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return problem.neighbours(a) < problem.neighbours(b); });
    std::size_t at = 0;
    for (; at < order.size() && problem.neighbours(order[at]) == 0; ++at) to.path[order[at]] = Path::undetermined;
    auto const batch_at = [&](std::size_t begin) {
      Each<ProcessorLanes> of;  // lanes beyond the last target repeat it
      for (std::size_t l = 0; l < of.size(); ++l) of[l] = order[std::min(begin + l, order.size() - 1)];
      return of;
    };
    for (; at < order.size(); at += lanes_of_processor) {
      batch.prefetch(batch_at(at + lanes_of_processor), to);
      batch.solve(batch_at(at), to);
    }
    for (std::size_t target : order) judge.repair(target, single);
  }
}

Equations equations(Problem const& problem, std::size_t target) { return Batch<Real>(problem).equations({target}); }

}  // namespace amrpic::gmls
