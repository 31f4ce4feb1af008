#include "solver/kokkos_backend.hpp"

#include <utility>

#include "base/runtime.hpp"
#include "kokkos/composite.hpp"
#include "kokkos/cycle.hpp"
#include "solver/backend.hpp"

namespace amrpic {

namespace {

Problem const& of_second_order(Problem const& problem) {
  if (problem.options.order != 2)
    throw SolverError("backend = \"kokkos\" has order 2 alone; set order to 2, or backend to \"matrix-free\"");
  return problem;
}

class KokkosBackend : public Backend {
 public:
  explicit KokkosBackend(Problem const& problem)
      : Backend(of_second_order(problem)), kernels_(std::make_unique<Kernels>(*this, problem)) {}

  void start(Field& phi, bool is_zero) override {
    Backend::start(phi, is_zero);
    kernels_->composite.start(*source_, phi, is_zero && composite_.has_residual_of_zero());
    is_under_way_ = true;
    host_takes_part_ = false;
  }
  void finish() override {
    kernels_->composite.potential_to_host();
    is_under_way_ = false;
    Backend::finish();
  }
  void set_mean(Field& phi, Real mean) const override {
    if (is_under_way_) kernels_->composite.potential_to_host();
    Backend::set_mean(phi, mean);
    if (is_under_way_) kernels_->composite.potential_to_device();
  }
  void walls_changed() override { kernels_->composite.walls_changed(); }
  void for_each_charge(Field const& phi, Field const& rho, CompositeResidual::OfCharge const& f) override {
    if (is_under_way_) kernels_->composite.potential_to_host();
    Backend::for_each_charge(phi, rho, f);
  }
  void accelerate() override {
    Backend::accelerate();
    host_takes_part_ = true;
    residuals_to_host();
  }
  Real largest_phi_term() override {
    kernels_->composite.potential_to_host();
    return Backend::largest_phi_term();
  }
  Real discretisation_error() override {
    kernels_->composite.potential_to_host();
    bool const before = std::exchange(host_takes_part_, true);
    residuals_to_host();
    Real const out = Backend::discretisation_error();
    for_each_level([](kokkos::SweptLevel& level) { level.right_hand_side().to_device(); });
    host_takes_part_ = before;
    return out;
  }
  std::size_t bytes() const override {
    return Backend::bytes() + kernels_->composite.bytes() + kernels_->cycle.bytes();
  }

 protected:
  Real find_residual() override {
    Real const out = kernels_->composite.residual(source_->background, problem_.options.norm, scale_);
    residuals_to_host();
    return out;
  }
  void run_cycle() override {
    if (host_takes_part_) for_each_level([](kokkos::SweptLevel& level) { level.right_hand_side().to_device(); });
    kernels_->cycle.run();
    if (host_takes_part_) for_each_level([](kokkos::SweptLevel& level) { level.correction().to_host(); });
  }
  Real add_correction(Real scale) override {
    if (host_takes_part_) for_each_level([](kokkos::SweptLevel& level) { level.correction().to_device(); });
    return kernels_->composite.add(scale);
  }

 private:
  struct Kernels {
    Kernels(KokkosBackend& plan, Problem const& problem)
        : cycle(problem.hierarchy->comm(), plan.cycle_), composite(plan.composite_.mesh(), levels_of(cycle, problem)) {}
    static std::vector<kokkos::SweptLevel*> levels_of(kokkos::Cycle& cycle, Problem const& problem) {
      std::vector<kokkos::SweptLevel*> out;
      for (int l = 0; l < problem.hierarchy->level_count(); ++l) out.push_back(&cycle.level(std::size_t(l)));
      return out;
    }
    kokkos::Cycle cycle;
    kokkos::Composite composite;
  };
  template <class F>
  void for_each_level(F&& f) {
    for (int l = 0; l < problem_.hierarchy->level_count(); ++l) f(kernels_->cycle.level(std::size_t(l)));
  }
  void residuals_to_host() {
    if (host_takes_part_) for_each_level([](kokkos::SweptLevel& level) { level.right_hand_side().to_host(); });
  }

  std::unique_ptr<Kernels> kernels_;
  bool is_under_way_ = false;     ///< whether the kernels' potential is newer than the host's
  bool host_takes_part_ = false;  ///< whether the host reads and writes residuals and corrections as well
  AtFinalize release_{[this] { kernels_.reset(); }};
};

}  // namespace

std::unique_ptr<Backend> make_kokkos_backend(Problem const& problem) {
  require_kokkos();
  return std::make_unique<KokkosBackend>(problem);
}

}  // namespace amrpic
