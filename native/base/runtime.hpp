// Start and end of Kokkos and Tpetra, and what must be released in between.
#pragma once

#include <functional>
#include <list>
#include <memory>
#include <optional>
#include <string>

namespace amrpic {

/// Start Tpetra, and with it Kokkos, on MPI_COMM_WORLD; a second call does nothing. MPI must be initialised.
void initialize();

/// Start a Kokkos that is built without Trilinos, at its first use: where its kernels find no device, all else of the
/// module works. Throws SolverError with the reason then, each time.
void require_kokkos();

/// Run all live `AtFinalize` callbacks, then stop Tpetra and Kokkos; without effect unless initialised. Collective.
void finalize();

/// A promise to release Trilinos objects while Kokkos still lives; forgotten when destroyed.
///
/// Python may drop its last handle on a solver after finalize(), and a Tpetra object destroyed then terminates the
/// process. Whoever owns Tpetra or Kokkos objects therefore keeps one of these, whose callback resets them.
class AtFinalize {
 public:
  explicit AtFinalize(std::function<void()> release);
  ~AtFinalize();
  AtFinalize(const AtFinalize&) = delete;
  AtFinalize& operator=(const AtFinalize&) = delete;

 private:
  std::list<std::function<void()>>::iterator place_;
};

/// Shared Trilinos or Kokkos objects, which go with their last owner, or before Kokkos does.
template <class Objects>
class UntilFinalize {
 public:
  UntilFinalize() = default;  ///< of nothing
  explicit UntilFinalize(Objects objects) : kept_(std::make_shared<Kept>(std::move(objects))) {}
  explicit operator bool() const { return kept_ && kept_->objects; }
  Objects const& operator*() const { return *kept_->objects; }
  Objects const* operator->() const { return &*kept_->objects; }

 private:
  struct Kept {
    explicit Kept(Objects&& given) : objects(std::move(given)) {}
    std::optional<Objects> objects;
    AtFinalize release{[this] { objects.reset(); }};
  };
  std::shared_ptr<Kept> kept_;
};

/// "13.2": version of the Trilinos this was compiled with; empty if it was without one, as below.
std::string trilinos_version();

/// "Kokkos 3.4.1 (Serial, concurrency 1)": the execution space of kernels, that of Tpetra's default node; with the name
/// of its graphics card, or the reason why there is none.
std::string kokkos_backend();

/// First line of what the MPI library says of itself.
std::string mpi_library();

}  // namespace amrpic
