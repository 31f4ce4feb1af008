#include "base/runtime.hpp"

#include <mpi.h>

#include "base/kokkos.hpp"
#ifdef AMRPIC_WITHOUT_TRILINOS
#include <Kokkos_Core.hpp>
#else
#include <Trilinos_version.h>

#include <Tpetra_Core.hpp>
#include <Tpetra_Map.hpp>
#endif
#include <algorithm>
#include <stdexcept>
#include <utility>

namespace amrpic {
namespace {

#ifdef AMRPIC_WITHOUT_TRILINOS
using Space = Kokkos::DefaultExecutionSpace;
#else
using Space = Tpetra::Map<>::node_type::execution_space;
#endif

bool initialized = false;

// Never destroyed: an AtFinalize may outlive the static objects of this file.
std::list<std::function<void()>>& releases() {
  static auto* list = new std::list<std::function<void()>>;
  return *list;
}

}  // namespace

void initialize() {
  if (initialized) return;
  int mpi_is_up = 0;
  MPI_Initialized(&mpi_is_up);
  if (!mpi_is_up) throw std::runtime_error("MPI is not initialised: import mpi4py.MPI before amrpic._native");
#ifdef AMRPIC_WITHOUT_TRILINOS
  try {
    Kokkos::initialize();
  } catch (std::runtime_error const& error) {
    std::string const reason = error.what();
    throw std::runtime_error("Kokkos finds no device for its " + std::string(Space::name()) +
                             " kernels: " + reason.substr(0, reason.find('\n')) +
                             "; run where one is, or build amrpic with a Kokkos for processors");
  }
#else
  // Tpetra reads argv even when there is nothing in it for Kokkos, so it gets a real one.
  static char name[] = "amrpic";
  static char* arguments[] = {name, nullptr};
  int argc = 1;
  char** argv = arguments;
  Tpetra::initialize(&argc, &argv);
#endif
  initialized = true;
}

void finalize() {
  if (!initialized) return;
  // A callback may destroy other promises, its own included, so the list is searched again each time.
  auto& list = releases();
  const auto is_open = [](const auto& release) { return static_cast<bool>(release); };
  for (auto at = list.begin(); (at = std::find_if(list.begin(), list.end(), is_open)) != list.end();) {
    std::exchange(*at, nullptr)();
  }
  initialized = false;
#ifdef AMRPIC_WITHOUT_TRILINOS
  Kokkos::finalize();
#else
  Tpetra::finalize();
#endif
}

AtFinalize::AtFinalize(std::function<void()> release)
    : place_(releases().insert(releases().end(), std::move(release))) {}

AtFinalize::~AtFinalize() { releases().erase(place_); }

#ifdef AMRPIC_WITHOUT_TRILINOS
std::string trilinos_version() { return ""; }
#else
std::string trilinos_version() { return TRILINOS_VERSION_STRING; }
#endif

std::string kokkos_backend() {
  std::string version = std::to_string(KOKKOS_VERSION / 10000);
  for (int part : {KOKKOS_VERSION / 100 % 100, KOKKOS_VERSION % 100}) version += "." + std::to_string(part);
  return "Kokkos " + version + " (" + Space::name() + ", concurrency " + std::to_string(Space().concurrency()) + ")";
}

}  // namespace amrpic
