#include "solver/smoother.hpp"

#include <Ifpack2_Factory.hpp>
#include <algorithm>
#include <array>

#include "multigrid/semicoarse.hpp"

namespace amrpic {

namespace {

using Colours = std::vector<std::vector<LocalIndex>>;

/// Rows of a level by the parity of i + j + k in the level's global indices, which no decomposition changes; around an
/// odd number of cells two of one parity meet, so the last ones are colours of their own. `chosen`: (cell) -> bool.
template <class Chosen>
Colours colours(Level const& level, Chosen const& chosen) {
  std::array<int, 3> odd_last;
  int rings = 0;
  for (int d = 0; d < 3; ++d) {
    bool const odd = level.periodic()[d] && level.domain().extent(d) % 2 != 0;
    odd_last[d] = odd ? level.domain().upper[d] : -1;
    rings += odd;
  }
  Colours out(rings > 0 ? 16 : 2);
  LocalIndex row = 0;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    for_each_cell(level.box(b), [&](Index3 const& c) {
      std::size_t place = 0;
      for (int d = 0; d < 3; ++d) place += c[d] == odd_last[d] ? std::size_t(1) << d : 0;
      if (chosen(c)) out[out.size() / 2 * std::size_t((c[0] + c[1] + c[2]) & 1) + place].push_back(row);
      ++row;
    });
  return out;
}

/// Relax some rows, of which none couples with another: x += relaxation (f - A x) / diagonal. The diagonal comes first
/// in each row.
void relax(DeviceArray<LocalIndex> const& rows, TpetraTypes::LocalMatrix const& a, Real relaxation,
           DeviceArray<Real const> const& f, DeviceArray<Real> const& x) {
  auto const start = a.graph.row_map;
  auto const column = a.graph.entries;
  auto const value = a.values;
  Kokkos::parallel_for(
      "relax", TpetraTypes::Rows(0, LocalIndex(rows.extent(0))), KOKKOS_LAMBDA(LocalIndex n) {
        LocalIndex const row = rows(n);
        Real product = 0;
        for (auto k = start(row); k < start(row + 1); ++k) product += value(k) * x(column(k));
        x(row) += relaxation * (f(row) - product) / value(start(row));
      });
}

/// Over-relaxed Gauss-Seidel, one colour after the other: rows of a colour do not couple with each other.
class RedBlack : public Smoother {
 public:
  RedBlack(LevelOperators const& operators, bool v_cycle, SolverOptions const& options, MetalCells const* metal)
      : operators_(operators),
        pre_sweeps_(options.pre_sweeps),
        post_sweeps_(options.post_sweeps),
        relaxation_(relaxation_on(*operators.level, shift_of(options), v_cycle, options.relaxation)) {
    Level const& level = *operators.level;
    colour_ = kept(colours(level, [](Index3 const&) { return true; }));
    if (metal) beside_metal_ = kept(colours(level, [&](Index3 const& cell) { return metal->cut_at(cell) != nullptr; }));
  }

  void smooth_from_zero(LevelVector const& f, LevelVector& x) override {
    x.set_zero();
    if (pre_sweeps_ == 0) return;
    auto const& colours = *colour_;
    relax_colour(colours[0], f, x);  // there is nothing to read yet
    for (std::size_t c = 1; c < colours.size(); ++c) {
      x.update_swept_halo();
      relax_colour(colours[c], f, x);
    }
    sweep(*colour_, pre_sweeps_ - 1, f, x);
  }
  void smooth(Side side, LevelVector const& f, LevelVector& x) override {
    int const sweeps = side == Side::before ? pre_sweeps_ : post_sweeps_;
    if (sweeps > 0 && beside_metal_) sweep(*beside_metal_, 1, f, x);
    sweep(*colour_, sweeps, f, x);
  }

 private:
  using OfColours = std::vector<DeviceArray<LocalIndex>>;
  static UntilFinalize<OfColours> kept(Colours const& colours) {
    OfColours out;
    for (auto const& rows : colours) out.push_back(on_device(rows));
    return UntilFinalize(std::move(out));
  }
  void sweep(OfColours const& colours, int sweeps, LevelVector const& f, LevelVector& x) {
    for (int s = 0; s < sweeps; ++s)
      for (auto const& rows : colours) {
        x.update_swept_halo();
        relax_colour(rows, f, x);
      }
  }
  void relax_colour(DeviceArray<LocalIndex> const& rows, LevelVector const& f, LevelVector& x) {
    relax(rows, operators_.no_fine.matrix()->getLocalMatrixDevice(), relaxation_, f.values(), x.values());
  }

  LevelOperators const& operators_;
  int pre_sweeps_, post_sweeps_;
  Real relaxation_;
  UntilFinalize<OfColours> colour_, beside_metal_;
};

/// Smallest eigenvalue, over the diagonal, of an error that oscillates along an axis which the next coarser level has
/// half the cells of.
Real oscillating(Real3 const& spacing) {
  Real const finest = *std::min_element(spacing.begin(), spacing.end());
  Real least = 0, sum = 0;
  for (Real h : spacing) {
    sum += 1 / h / h;
    if (h <= 1.5 * finest && (least == 0 || 1 / h / h < least)) least = 1 / h / h;
  }
  return least / sum;
}

/// A smoother of Ifpack2; over several ranks each relaxes its own rows at a time.
class LibrarySmoother : public Smoother {
 public:
  LibrarySmoother(LevelOperators const& operators, SolverOptions const& options) {
    auto const made = [&](int sweeps, bool from_zero) -> Method {
      if (sweeps == 0) return {};
      auto out =
          Ifpack2::Factory::create<TpetraTypes::RowMatrix>(ifpack2_name(options.smoother), operators.no_fine.matrix());
      out->setParameters(ifpack2_parameters(options, sweeps, from_zero, oscillating(operators.level->spacing())));
      out->initialize();
      out->compute();
      return out;
    };
    Methods methods;
    methods.after = made(options.post_sweeps, false);
    methods.from_zero = made(options.pre_sweeps, true);
    methods.before = options.pre_sweeps == options.post_sweeps ? methods.after : made(options.pre_sweeps, false);
    methods_ = UntilFinalize(std::move(methods));
  }

  void smooth_from_zero(LevelVector const& f, LevelVector& x) override {
    x.set_zero();
    apply(methods_->from_zero, f, x);
  }
  void smooth(Side side, LevelVector const& f, LevelVector& x) override {
    apply(side == Side::before ? methods_->before : methods_->after, f, x);
  }

 private:
  using Method = Teuchos::RCP<Ifpack2::Preconditioner<Real, LocalIndex, TpetraTypes::Global, TpetraTypes::Node>>;
  struct Methods {
    Method from_zero, before, after;  ///< null for no sweeps
  };

  static void apply(Method const& method, LevelVector const& f, LevelVector& x) {
    if (!method.is_null()) method->apply(f.own(), x.own());
  }

  UntilFinalize<Methods> methods_;
};

}  // namespace

std::unique_ptr<Smoother> make_smoother(LevelOperators const& operators, bool v_cycle, SolverOptions const& options,
                                        MetalCells const* metal) {
  if (options.smoother == SmootherKind::red_black)
    return std::make_unique<RedBlack>(operators, v_cycle, options, metal);
  return std::make_unique<LibrarySmoother>(operators, options);
}

}  // namespace amrpic
