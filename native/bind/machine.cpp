#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <utility>

#include "base/communicator.hpp"
#include "base/destinations.hpp"
#include "base/error.hpp"
#include "base/fma_peak.hpp"
#include "base/runtime.hpp"
#include "bind/bind.hpp"
#include "bind/communicator.hpp"
#include "mesh/exchange.hpp"

namespace {

/// A number that is added to those of other ranks, or of which the largest counts.
struct Number {
  Real value;
  Real by_largest;

  void add(Number const& other) { value = by_largest > 0 ? std::max(value, other.value) : value + other.value; }
};

}  // namespace

void bind_machine(nb::module_& m) {
  m.def(
      "end_job_on_failure", [](int comm) { end_job_on_failure(MPI_Comm_f2c(comm)); }, "comm"_a,
      "Let a failure of MPI on a communicator of the library's own end the job with one sentence.");
  m.def("fail_alone", &fail_alone, "what"_a,
        "Of a broken promise that one rank alone finds: end a job of several with this sentence; raise, if it has one "
        "rank.");
  m.def(
      "traffic",
      [] {
        Traffic const& all = traffic();
        return std::array{all.messages, all.bytes, all.collectives};
      },
      "Messages and bytes that this process has sent to other ranks so far, and collective calls.");
  m.def(
      "take_destinations", [] { return std::exchange(destinations(), {}); },
      "The ranks that virtual ranks of this process have sent messages to since the last call, and how many bytes.");
  m.def(
      "count_collective", [] { ++traffic().collectives; }, "Count a collective call that Python makes.");
  m.def(
      "sums_and_largest",
      [](bind::Ranks comm, std::vector<Real> const& summed, std::vector<Real> const& compared) {
        std::vector<Number> numbers;
        for (Real value : summed) numbers.push_back({value, 0});
        for (Real value : compared) numbers.push_back({value, 1});
        {
          nb::gil_scoped_release release;
          bind::communicator(comm).add_each(numbers);
        }
        std::vector<Real> out;
        for (Number const& number : numbers) out.push_back(number.value);
        return out;
      },
      "comm"_a, "summed"_a, "compared"_a,
      "The sums over all ranks of some numbers, and behind them the largest of others, in one reduction.");
  m.def(
      "exchange",
      [](int comm, std::vector<std::pair<int, std::int64_t>> const& asked,
         std::vector<std::pair<int, std::int64_t>> const& wanted, nb::callable const& pack) {
        auto parcels = [](auto const& list) {
          std::vector<Parcel> out;
          for (auto const& [rank, values] : list) out.push_back({rank, values});
          return out;
        };
        std::vector<std::vector<double>> out(wanted.size());
        Exchange<double> const exchange(Communicator(MPI_Comm_f2c(comm)), parcels(asked), parcels(wanted));
        exchange.update(
            [&](std::size_t n, double* to) {
              try {
                auto const values = nb::cast<std::vector<double>>(pack(n));
                std::copy(values.begin(), values.end(), to);
              } catch (nb::python_error& e) {  // whose text has many lines
                throw std::runtime_error(nb::str(e.value()).c_str());
              }
            },
            [&](std::size_t n, double const* from) { out[n].assign(from, from + wanted[n].second); });
        return out;
      },
      "comm"_a, "asked"_a, "wanted"_a, "pack"_a,
      "Values of parcels between ranks, (rank, number) each, once; pack(n) gives those that rank asked[n][0] reads.");
  m.def("measure_fma_peak", &measure_fma_peak, nb::call_guard<nb::gil_scoped_release>(),
        "Most operations per second of products and sums of vectors in registers, two each, the best of many short "
        "runs.");
  m.def("initialize", &initialize, "Start Kokkos and Tpetra on MPI_COMM_WORLD, once; MPI must be up.");
  m.def("finalize", &finalize, "Release what solvers hold of Trilinos, then stop it; MPI must still be up.");
  m.def("trilinos_version", &trilinos_version, "Version of the Trilinos headers, such as '13.2'.");
  m.def("kokkos_backend", &kokkos_backend,
        "Version of Kokkos, the execution space of its kernels, and how many threads that has; empty without it.");
  m.def("mpi_library", &mpi_library, "Version line of the MPI library this module calls.");
}
