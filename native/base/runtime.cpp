#include "base/runtime.hpp"

#include <mpi.h>

#include "base/error.hpp"
#include "base/pool.hpp"
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

/// " on NVIDIA H100": the graphics card of kernels, empty on the host.
std::string card_name() {
#if defined(KOKKOS_ENABLE_CUDA)
  return std::string(" on ") + Kokkos::Cuda().cuda_device_prop().name;
#elif defined(KOKKOS_ENABLE_HIP)
  return std::string(" on ") + Kokkos::HIP().hip_device_prop().name;
#else
  return "";
#endif
}

/// Let a card copy from and to large arrays directly: through memory of the driver's it takes several times as long.
void lock_pages() {
#if defined(KOKKOS_ENABLE_CUDA)
  Pool::lock_pages({[](void* memory, std::size_t bytes) {
                      if (cudaHostRegister(memory, bytes, cudaHostRegisterDefault) != cudaSuccess) cudaGetLastError();
                    },
                    [](void* memory) {
                      if (cudaHostUnregister(memory) != cudaSuccess) cudaGetLastError();
                    }});
#elif defined(KOKKOS_ENABLE_HIP)
  Pool::lock_pages({[](void* memory, std::size_t bytes) {
                      if (hipHostRegister(memory, bytes, hipHostRegisterDefault) != hipSuccess) (void)hipGetLastError();
                    },
                    [](void* memory) {
                      if (hipHostUnregister(memory) != hipSuccess) (void)hipGetLastError();
                    }});
#endif
}

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
#ifndef AMRPIC_WITHOUT_TRILINOS
  // Tpetra reads argv even when there is nothing in it for Kokkos, so it gets a real one.
  static char name[] = "amrpic";
  static char* arguments[] = {name, nullptr};
  int argc = 1;
  char** argv = arguments;
  Tpetra::initialize(&argc, &argv);
  initialized = true;
  lock_pages();
#endif
}

void require_kokkos() {
#ifdef AMRPIC_WITHOUT_TRILINOS
  static std::string reason;  // Kokkos cannot be asked a second time
  if (!initialized && reason.empty()) try {
      Kokkos::initialize();
      initialized = true;
      lock_pages();
    } catch (std::exception const& error) {
      reason = error.what();
      reason = "Kokkos finds no device for its " + std::string(Space::name()) +
               " kernels: " + reason.substr(0, std::min(reason.find('\n'), reason.find(" /"))) +  // source lines follow
               "; run where one is, or set backend to \"matrix-free\"";
    }
  if (!initialized) throw SolverError(reason);
#endif
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
  std::string version = "Kokkos " + std::to_string(KOKKOS_VERSION / 10000);
  for (int part : {KOKKOS_VERSION / 100 % 100, KOKKOS_VERSION % 100}) version += "." + std::to_string(part);
  try {
    require_kokkos();
  } catch (SolverError const& error) {
    return version + ", which cannot run here: " + error.what();
  }
  std::string const threads = "concurrency " + std::to_string(Space().concurrency());
  return version + " (" + Space::name() + card_name() + ", " + threads + ")";
}

}  // namespace amrpic
