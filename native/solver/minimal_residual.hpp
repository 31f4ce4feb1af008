#pragma once

#include <algorithm>
#include <deque>
#include <functional>
#include <utility>
#include <vector>

#include "base/communicator.hpp"
#include "cycle/vector.hpp"

namespace amrpic {

/// Corrections of cycles that converge slowly, combined for the least residual in the 2-norm over the latest few of
/// them: flexible GMRES with a window in place of restarts. Few outlying errors cost cycles their rate, such as those
/// that a coarser level overshoots in beside a refined one; they are gone after as many steps.
///
/// The corrections are kept as cycles found them, not made orthogonal: in single precision that would part them from
/// their images, and each more would make matters worse.
class MinimalResidual {
 public:
  using Vectors = std::vector<cycle::Vector>;  ///< [level]
  /// The product over own uncovered cells of this rank.
  using Dot = std::function<Real(Vectors const&, Vectors const&)>;

  void clear() { kept_.clear(); }

  /// Of a correction, the residual before it and the residual after it: make of the correction what is still to be
  /// added for the least residual. Collective.
  void improve(Vectors& correction, Vectors const& before, Vectors const& after, Dot const& dot,
               Communicator const& comm) {
    Vectors image = before;
    add(-1, after, image);
    if (kept_.size() == most_directions) kept_.pop_back();
    kept_.push_front({correction, std::move(image), {}});
    std::vector<Real> products;
    for (Direction const& old : kept_) products.push_back(dot(kept_.front().image, old.image));
    for (Direction const& old : kept_) products.push_back(dot(before, old.image));
    products.push_back(dot(before, before));
    comm.sum_each(products);
    auto const end = products.begin() + std::ptrdiff_t(kept_.size());
    kept_.front().products.assign(products.begin(), end);
    std::vector<Real> const right(end, products.end() - 1);

    std::vector<Real> const weight = weights(right);
    Real gain = 0;  // of the squared residual
    for (std::size_t k = 0; k < weight.size(); ++k) gain += weight[k] * right[k];
    // Where nothing is gained the next cycle would find the same once more, while plain ones get over it.
    bool const stalls = !(gain > 0.1 * products.back());
    for (auto& level : correction) std::fill(level.begin(), level.end(), 0.0f);
    if (stalls) return;
    for (std::size_t k = 0; k < weight.size(); ++k) add(weight[k] - (k == 0 ? 1 : 0), kept_[k].change, correction);
  }

 private:
  static constexpr std::size_t most_directions = 16;
  struct Direction {
    Vectors change, image;       ///< of the potential, and what it takes from the residual
    std::vector<Real> products;  ///< of the image with itself and older ones
  };

  /// Weights of the kept corrections for the least residual, by elimination from the latest on; zero for images that
  /// depend linearly on later ones, up to rounding.
  std::vector<Real> weights(std::vector<Real> right) const {
    std::size_t const n = kept_.size();
    std::vector<std::vector<Real>> a(n, std::vector<Real>(n));
    for (std::size_t i = 0; i < n; ++i)
      for (std::size_t j = i; j < n; ++j) a[i][j] = a[j][i] = kept_[i].products[j - i];
    std::vector<bool> is_new(n);
    for (std::size_t i = 0; i < n; ++i) {
      is_new[i] = a[i][i] > 1e-10 * kept_[i].products[0];
      for (std::size_t row = i + 1; row < n && is_new[i]; ++row) {
        Real const factor = a[row][i] / a[i][i];
        for (std::size_t j = i; j < n; ++j) a[row][j] -= factor * a[i][j];
        right[row] -= factor * right[i];
      }
    }
    std::vector<Real> out(n, 0);
    for (std::size_t i = n; i-- > 0;) {
      if (!is_new[i]) continue;
      for (std::size_t j = i + 1; j < n; ++j) right[i] -= a[i][j] * out[j];
      out[i] = right[i] / a[i][i];
    }
    return out;
  }

  static void add(Real factor, Vectors const& from, Vectors& to) {
    for (std::size_t l = 0; l < to.size(); ++l)
      for (std::size_t i = 0; i < to[l].size(); ++i) to[l][i] += float(factor) * from[l][i];
  }
  std::deque<Direction> kept_;  ///< the latest first
};

}  // namespace amrpic
