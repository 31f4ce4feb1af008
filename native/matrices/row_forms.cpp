#include "matrices/row_forms.hpp"

#include <cstring>

#include "base/error.hpp"

namespace amrpic {

namespace {

using T = TpetraTypes;

std::size_t hash_of(Form const& form) {
  std::size_t out = form.terms().size();
  for (auto const& [unknown, weight] : form.terms()) {
    std::uint64_t bits;
    std::memcpy(&bits, &weight, sizeof bits);
    for (std::int8_t o : unknown.offset) bits = bits * 31 + std::size_t(o + 64);
    out = 0x9e3779b97f4a7c15 * (out ^ out >> 32 ^ bits);
  }
  return out ^ out >> 32;
}

/// Cells along x: their rows, and where they lie.
struct Line {
  LocalIndex row, count;
  int box, first, j, k;
};

std::vector<Line> lines_of(Level const& level) {
  std::vector<Line> out;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    Box const& box = level.box(b);
    LocalIndex row = level.local_offset(b);
    for_each_row(box, [&](Index3 const& first) {
      out.push_back({row, box.extent(0), b - level.first_local_box(), first[0], first[1], first[2]});
      row += box.extent(0);
    });
  }
  return out;
}

/// Write where rows start, and what would follow them: the number of entries, which is returned. `first`: term of each
/// form.
template <class First, class FormOfRow>
std::size_t count_entries(First const& first, FormOfRow const& form_of_row, T::RowStarts const& start) {
  LocalIndex const rows = LocalIndex(form_of_row.extent(0));
  std::size_t entries = 0;
  Kokkos::parallel_scan(
      "count entries", T::Rows(0, rows),
      KOKKOS_LAMBDA(LocalIndex row, std::size_t & sum, bool last) {
        LocalIndex const form = form_of_row(row);
        if (form != no_form) sum += std::size_t(first(form + 1) - first(form));
        if (last) start(row + 1) = sum;
        if (last && row == 0) start(0) = 0;
      },
      entries);
  if (rows == 0) Kokkos::deep_copy(start, 0);
  return entries;
}

}  // namespace

bool FormTable::equal(LocalIndex number, Form const& form) const {
  std::size_t const first = std::size_t(start_[std::size_t(number)]);
  if (std::size_t(start_[std::size_t(number) + 1]) - first != form.terms().size()) return false;
  for (std::size_t t = 0; t < form.terms().size(); ++t)
    if (form.terms()[t].column.offset != offset_[first + t] || form.terms()[t].value != weight_[first + t])
      return false;
  return true;
}

LocalIndex FormTable::number(Form const& form) {
  if (form.terms().empty()) return no_form;
  std::size_t const hash = hash_of(form);
  auto const [first, last] = by_hash_.equal_range(hash);
  for (auto at = first; at != last; ++at)
    if (equal(at->second, form)) return at->second;
  LocalIndex const number = LocalIndex(start_.size()) - 1;
  for (auto const& [unknown, weight] : form.terms()) offset_.push_back(unknown.offset), weight_.push_back(weight);
  start_.push_back(LocalIndex(weight_.size()));
  by_hash_.emplace(hash, number);
  return number;
}

void NearPlaces::add(ArrayOnBox<LocalIndex> const& places) {
  Box const& box = places.box();
  int const pitch_y = box.empty() ? 0 : box.extent(0), pitch_z = pitch_y * box.extent(1);
  std::int64_t const first = box.lower[0] + std::int64_t(pitch_y) * box.lower[1] + std::int64_t(pitch_z) * box.lower[2];
  region_.push_back({std::int64_t(values_.size()) - first, pitch_y, pitch_z});
  values_.insert(values_.end(), places.values().begin(), places.values().end());
}

SparseMatrix filled(FormTable const& table, RowForms const& row_forms, NearPlaces const& near, Anchor const& anchor,
                    LevelCells const& rows, LevelCells const& columns) {
  using Team = Kokkos::TeamPolicy<T::Space>::member_type;
  auto const form_of_row = seen_by_device(row_forms.values());
  auto const first_term = seen_by_device(table.starts());
  auto const offset = seen_by_device(table.offsets());
  auto const weight = seen_by_device(table.weights());
  auto const places = seen_by_device(near.values());
  auto const regions = seen_by_device(near.regions());
  auto const lines_here = lines_of(rows.level());
  auto const lines = seen_by_device(lines_here);
  auto const row_start = unset_array<T::RowStarts>(row_forms.values().size() + 1);
  std::size_t const entries = count_entries(first_term, form_of_row, row_start);
  auto const column = unset_array<T::Columns>(entries);
  auto const value = unset_array<T::MatrixValues>(entries);
  Index3 const times = anchor.times, over = anchor.over;

  LocalIndex missing = 0;
  Kokkos::parallel_reduce(
      "fill rows", Kokkos::TeamPolicy<T::Space>(int(lines.extent(0)), Kokkos::AUTO),
      KOKKOS_LAMBDA(Team const& team, LocalIndex& sum) {
        Line const line = lines(team.league_rank());
        NearPlaces::Region const region = regions(line.box);
        std::int64_t const origin = region.origin + std::int64_t(region.pitch_y) * (line.j * times[1] / over[1]) +
                                    std::int64_t(region.pitch_z) * (line.k * times[2] / over[2]);
        LocalIndex of_line = 0;
        Kokkos::parallel_reduce(
            Kokkos::TeamVectorRange(team, line.count),
            [&](LocalIndex n, LocalIndex& absent) {
              LocalIndex const form = form_of_row(line.row + n);
              if (form == no_form) return;
              std::int64_t const here = origin + (line.first + n) * times[0] / over[0];
              std::size_t at = row_start(line.row + n);
              for (LocalIndex t = first_term(form); t < first_term(form + 1); ++t, ++at) {
                auto const& o = offset(t);
                LocalIndex const place = places(here + o[0] + region.pitch_y * o[1] + region.pitch_z * o[2]);
                absent += place == no_place;
                column(at) = place;
                value(at) = weight(t);
              }
            },
            of_line);
        Kokkos::single(Kokkos::PerTeam(team), [&] { sum += of_line; });
      },
      missing);
  if (missing > 0) fail_alone("a stencil reached for a cell that does not exist");
  T::LocalMatrix const local("operator", LocalIndex(form_of_row.extent(0)), columns.columns(), entries, value,
                             row_start, column);
  return SparseMatrix(local, rows, columns);
}

}  // namespace amrpic
