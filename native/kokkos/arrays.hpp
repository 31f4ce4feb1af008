// Arrays and loops of Kokkos' default execution space.
#pragma once

#include <Kokkos_Core.hpp>
#include <algorithm>
#include <cstdint>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/range.hpp"
#include "cycle/row_kernels.hpp"

namespace amrpic::kokkos {

using Space = Kokkos::DefaultExecutionSpace;

template <class T>
using Array = Kokkos::View<T*, Kokkos::LayoutLeft, Space>;
/// Memory that others own.
template <class T>
using OnHost = Kokkos::View<T*, Kokkos::LayoutLeft, Kokkos::HostSpace, Kokkos::MemoryUnmanaged>;

/// Whether kernels read and write the host's own memory: nothing is copied then, and a row belongs to one thread.
/// AMRPIC_APART rehearses a card on the host: with copies of their own, and teams.
#ifdef AMRPIC_APART
constexpr bool on_host = false;
#else
constexpr bool on_host = std::is_same_v<Space::memory_space, Kokkos::HostSpace>;
#endif

/// Copy values and wait; without any, nothing is waited for.
template <class To, class From>
void copy_values(To const& to, From const& from) {
  if (from.size() > 0) Kokkos::deep_copy(to, from);
}
/// Set values, in turn with kernels.
template <class T>
void fill(Array<T> const& array, T const& value) {
  if (array.size() > 0) Kokkos::deep_copy(Space(), array, value);
}

/// A host's values as kernels have them: themselves, or a copy, which is brought up to date where the caller says so.
template <class T>
class Mirrored {
 public:
  Mirrored() = default;
  Mirrored(T* host, std::size_t n) {
    stand_for(host, n);
    to_device();
  }
  /// From now on these are other values of the host, which kernels have yet to get. Their memory is used again.
  void stand_for(T* host, std::size_t n) {
    host_ = OnHost<T>(host, n);
    if constexpr (on_host) {
      array_ = Array<T>(host, n);
    } else {
      if (room_.size() < n) {
        array_ = room_ = {};
        room_ = Array<T>(Kokkos::view_alloc(Kokkos::WithoutInitializing, "values"), n);
      }
      array_ = Kokkos::subview(room_, std::make_pair(std::size_t(0), n));
    }
  }
  KOKKOS_INLINE_FUNCTION Array<T> const& array() const { return array_; }
  void to_device() const {
    if constexpr (!on_host) copy_values(array_, host_);
  }
  void zeros_to_device() const {  ///< which the host's values are
    if constexpr (!on_host) fill(array_, T(0));
  }
  void to_host() const {
    if constexpr (on_host)
      Kokkos::fence();
    else
      copy_values(host_, array_);
  }

 private:
  OnHost<T> host_;
  Array<T> array_, room_;
};

/// A copy of a list in the kernels' memory.
template <class T, class Allocator>
Array<T> on_device(std::vector<T, Allocator> const& values) {
  Array<T> out(Kokkos::view_alloc(Kokkos::WithoutInitializing, "list"), values.size());
  Kokkos::deep_copy(out, OnHost<T const>(values.data(), values.size()));
  return out;
}

/// Run f(n) for n of a range, in any order.
template <class F>
void for_each(char const* name, Range const& range, F const& f) {
  if (range.first < range.last) Kokkos::parallel_for(name, Kokkos::RangePolicy<Space>(range.first, range.last), f);
}
template <class T, class F>
void for_each(char const* name, Array<T> const& list, F const& f) {
  for_each(name, Range{0, std::int32_t(list.extent(0))}, f);
}

// ---- rows: on the host each is a thread's, which vectorises along it; elsewhere a team's ----

/// Call f(i, value before, value after) for the cells [first, last) of a row of n, whose ends have values beyond them.
template <class T, class F>
KOKKOS_INLINE_FUNCTION void along(int first, int last, int n, T const* here, T left, T right, F const& f) {
  int i = first;
  if (i == 0 && i < last) {
    f(0, left, n > 1 ? here[1] : right);
    i = 1;
  }
  int const end = last < n - 1 ? last : n - 1;
#pragma GCC ivdep
  for (int m = i; m < end; ++m) f(m, here[m - 1], here[m + 1]);
  if (last == n && n > 1) f(n - 1, here[n - 2], right);
}

using Team = Kokkos::TeamPolicy<Space>::member_type;

/// So many teams. On a card they are small: rows are short, and the more of them are under way the less is waited for.
inline Kokkos::TeamPolicy<Space> teams(std::int32_t count) {
#ifdef AMRPIC_APART
  return {count, Kokkos::AUTO};
#else
  return {count, 64};
#endif
}
/// How many are under way at once, at least.
inline std::int32_t teams_at_once() { return std::max(1, std::int32_t(Space().concurrency()) / 128); }

/// Whoever works on one row.
struct Worker {
  static constexpr bool has_vectors = on_host;
  Team const* team;  ///< null on the host

  /// Call f(lanes, isotropic) with both as constants; elsewhere cells are no vectors.
  template <class F>
  KOKKOS_INLINE_FUNCTION void with_kind(int lanes, bool isotropic, F const& f) const {
    if constexpr (on_host)
      cycle::with_kind(lanes, isotropic, f);
    else
      f(std::integral_constant<int, 1>(), std::integral_constant<bool, false>());
  }

  /// Run f(i) for i of 0 .. n - 1, none of which reads what another writes.
  template <class F>
  KOKKOS_INLINE_FUNCTION void for_each(int n, F const& f) const {
    if constexpr (on_host) {
#pragma GCC ivdep
      for (int i = 0; i < n; ++i) f(i);
    } else {
      Kokkos::parallel_for(Kokkos::TeamVectorRange(*team, n), f);
    }
  }
  /// What was written before is there for all that work on the row.
  KOKKOS_INLINE_FUNCTION void barrier() const {
    if constexpr (!on_host) team->team_barrier();
  }
};

namespace rows {

template <class F>
struct Loop {
  F f;
  std::int32_t first;
  KOKKOS_INLINE_FUNCTION void operator()(std::int32_t row) const { f(Worker{nullptr}, row); }
  KOKKOS_INLINE_FUNCTION void operator()(Team const& team) const { f(Worker{&team}, first + team.league_rank()); }
};

/// The sum, or the largest, of what f gives for each row: to each thread of a team its own part.
template <class F>
struct Reduction {
  using value_type = double;
  F f;
  bool largest;
  std::int32_t rows;
  KOKKOS_INLINE_FUNCTION void init(double& out) const { out = 0; }
  KOKKOS_INLINE_FUNCTION void join(volatile double& out, double const volatile& other) const { combine(out, other); }
  KOKKOS_INLINE_FUNCTION void join(double& out, double const& other) const { combine(out, other); }
  template <class A>
  KOKKOS_INLINE_FUNCTION void combine(A& out, double value) const {
    out = !largest ? out + value : value > out ? value : double(out);
  }
  KOKKOS_INLINE_FUNCTION void operator()(std::int32_t row, double& out) const { combine(out, f(Worker{nullptr}, row)); }
  KOKKOS_INLINE_FUNCTION void operator()(Team const& team, double& out) const {
    for (std::int32_t row = team.league_rank(); row < rows; row += team.league_size())
      combine(out, f(Worker{&team}, row));
  }
};

}  // namespace rows

/// Run f(worker, row) for the rows of a range.
template <class F>
void for_each_row(char const* name, Range const& range, F const& f) {
  if (range.first >= range.last) return;
  if constexpr (on_host)
    Kokkos::parallel_for(name, Kokkos::RangePolicy<Space>(range.first, range.last), rows::Loop<F>{f, 0});
  else
    Kokkos::parallel_for(name, teams(range.last - range.first), rows::Loop<F>{f, range.first});
}
template <class T, class F>
void for_each_row(char const* name, Array<T> const& list, F const& f) {
  for_each_row(name, Range{0, std::int32_t(list.extent(0))}, f);
}

/// The sum, or the largest, of f(worker, row) over a list of rows.
template <class T, class F>
double reduced(char const* name, Array<T> const& list, bool largest, F const& f) {
  double out = 0;
  std::int32_t const count = std::int32_t(list.extent(0));
  if (count == 0) return out;
  rows::Reduction<F> const reduction{f, largest, count};
  if constexpr (on_host)
    Kokkos::parallel_reduce(name, Kokkos::RangePolicy<Space>(0, count), reduction, out);
  else
    Kokkos::parallel_reduce(name, teams(std::min(count, teams_at_once())), reduction, out);
  return out;
}

}  // namespace amrpic::kokkos
