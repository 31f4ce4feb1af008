#include "particle/rearrange.hpp"

#include <algorithm>
#include <cmath>

namespace amrpic {

namespace {

constexpr LocalIndex part_size = 512;

/// Ids as numbers of eight bytes, to be copied and nothing else.
Real* as_reals(std::int64_t* ids) { return reinterpret_cast<Real*>(ids); }

}  // namespace

struct Rearrangement::Part {
  LocalIndex count, stayed, came;
  std::uint8_t const* moved;
  Group const *group, *groups_end;
  LocalIndex const *mover, *movers_end;  ///< all that are known: those behind the first `came` are asked for
};

void Rearrangement::insert(LocalIndex place, std::int64_t n) {
  std::size_t const bit = std::size_t(n - first_moved_);
  if (moved_.size() <= bit / lane_count) moved_.resize(bit / lane_count + 1, 0);
  moved_[bit / lane_count] |= std::uint8_t(1 << bit % lane_count);
  movers_.push_back(place);
}

bool Rearrangement::write_most(ParticleView const& out, bool far) {
  return write_while(2 * part_size, out, far);  // the next ones are asked for meanwhile
}

bool Rearrangement::write_rest(ParticleView const& out, bool far) { return write_while(1, out, far); }

/// Write in parts, as long as so many are left.
bool Rearrangement::write_while(LocalIndex least, ParticleView const& out, bool far) {
  bool finite = true;
  while (known_ - written_ >= least) {
    LocalIndex const count = LocalIndex(std::min<std::int64_t>(part_size, known_ - written_));
    finite = (far ? write<true>(count, out) : write<false>(count, out)) && finite;
  }
  forget_written();
  return finite;
}

template <bool far>
bool Rearrangement::write(LocalIndex count, ParticleView const& out) {
  std::size_t const bytes = std::size_t(known_ - first_moved_) / lane_count + 1;
  if (moved_.size() < bytes) moved_.resize(bytes, 0);
  Part part{count,
            0,
            0,
            moved_.data() + (written_ - first_moved_) / lane_count,
            groups_.data() + groups_written_,
            nullptr,
            movers_.data() + movers_written_,
            movers_.data() + movers_.size()};
  for (LocalIndex i = 0; i < count; i += lane_count) part.came += __builtin_popcount(part.moved[i / lane_count]);
  part.stayed = count - part.came;
  LocalIndex read = carried_;
  for (part.groups_end = part.group; read < part.stayed; ++part.groups_end)
    read += __builtin_popcount(part.groups_end->bits);

  auto const write_one = [&](int column, Real const* from, Real* to, bool check = false) {
    return write_column<far>(part, from, to + written_, carry_[column], check);
  };
  bool finite = true;
  for (int d = 0; d < 3; ++d) write_one(d, from_.position[d], out.position[d]);
  for (int d = 0; d < 3; ++d) finite = write_one(3 + d, from_.momentum[d], out.momentum[d], true) && finite;
  write_one(6, from_.weight, out.weight);
  write_one(7, as_reals(from_.id), as_reals(out.id));

  carried_ = read - part.stayed;
  groups_written_ = std::size_t(part.groups_end - groups_.data());
  movers_written_ += std::size_t(part.came);
  written_ += count;
  return finite;
}

/// Write one column of a part, and put what is left of its last group into `carry`, from where this one's first values
/// are taken. Whether all are finite, if that is to be checked.
template <bool far>
bool Rearrangement::write_column(Part const& part, Real const* from, Real* to, Real* carry, bool check) const {
  alignas(64) Real stayed[part_size + 2 * lane_count], came[part_size + lane_count];
  store(stayed, load<Lanes>(carry));
  LocalIndex read = carried_;
  for (Group const* group = part.group; group < part.groups_end; ++group) {
    bring_near(from + group->first + part_size);
    read += compress(group->bits, load_up_to<Lanes>(from + group->first, from_.count - group->first), stayed + read);
  }
  for (LocalIndex i = 0; i < part.came; ++i) came[i] = part.mover[i] < from_.count ? from[part.mover[i]] : 0;
  LocalIndex const* const ahead = part.mover + part.came;
  for (LocalIndex const* next = ahead; next < std::min(ahead + part.came, part.movers_end); ++next)
    bring_near(from + *next);

  Real const *next_stayed = stayed, *next_came = came;
  bool finite = true;
  Lanes zero{};  // nan as soon as a value is not finite
  for (LocalIndex i = 0; i < part.count; i += lane_count) {
    unsigned const moved = part.moved[i / lane_count];
    Lanes const eight = mix(moved, next_came, next_stayed);
    next_came += __builtin_popcount(moved);
    next_stayed += lane_count - __builtin_popcount(moved);
    if (i + lane_count > part.count) {
      for (LocalIndex j = i; j < part.count; ++j) to[j] = eight[j - i], finite = finite && std::isfinite(to[j]);
    } else if (far) {
      stream(to + i, eight);
    } else {
      store(to + i, eight);
    }
    if (check && i + lane_count <= part.count) zero += eight - eight;
  }
  store(carry, load<Lanes>(stayed + part.stayed));
  return finite && bits_of(zero == 0) == all_lanes;
}

/// Drop what is written once it is the larger part, so that dropping takes no longer than adding.
void Rearrangement::forget_written() {
  auto const drop = [](auto& values, std::size_t& written) {
    if (2 * written < values.size()) return;
    values.erase(values.begin(), values.begin() + std::ptrdiff_t(written));
    written = 0;
  };
  drop(groups_, groups_written_);
  drop(movers_, movers_written_);
  std::size_t bytes = std::size_t(written_ - first_moved_) / lane_count;
  std::int64_t const last_moved = first_moved_ + std::int64_t(bytes) * lane_count;
  drop(moved_, bytes);
  if (bytes == 0) first_moved_ = last_moved;
}

}  // namespace amrpic
