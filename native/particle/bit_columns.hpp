// Rows of whole numbers in as few bits as hold them.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <numeric>
#include <vector>

#include "base/types.hpp"

namespace amrpic {

/// A number such that those of like size and sign are near each other: its sign is the last bit. `real_of` inverts it.
inline std::uint64_t ordered_bits(Real value) {
  std::uint64_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits << 1 | bits >> 63;
}
inline Real real_of(std::uint64_t ordered) {
  std::uint64_t const bits = ordered >> 1 | ordered << 63;
  Real out;
  std::memcpy(&out, &bits, sizeof out);
  return out;
}

/// Rows of numbers, one for each column, of which only what exceeds the column's least is kept, in as many bits as the
/// largest needs. What comes out is what went in, to the last bit (J. Goldstein et al., "Compressing Relations and
/// Indexes", ICDE 1998).
///
/// In words: the least of each column, the bits of each, eight of these to a word, and the rows without gaps.
template <std::size_t columns>
class BitColumns {
 public:
  using Row = std::array<std::uint64_t, columns>;

  /// The words for some rows; none for none.
  static std::vector<std::int64_t> packed(std::vector<Row> const& rows) {
    if (rows.empty()) return {};
    BitColumns const format(rows);
    std::vector<std::int64_t> out(header + (rows.size() * format.row_bits() + 63) / 64, 0);
    format.write(out.data());
    std::int64_t* to = out.data() + header;
    std::uint64_t word = 0;
    unsigned filled = 0;  // bits of it
    for (Row const& row : rows)
      for (std::size_t c = 0; c < columns; ++c) {
        std::uint64_t const value = row[c] - format.least_[c];
        word |= value << filled;
        filled += format.bits_[c];
        if (filled < 64) continue;
        *to++ = std::int64_t(word);
        filled -= 64;
        word = filled > 0 ? value >> (format.bits_[c] - filled) : 0;
      }
    if (filled > 0) *to = std::int64_t(word);
    return out;
  }

  /// Call f(row) for so many rows in these words. Returns the words behind them.
  template <class F>
  static std::int64_t const* unpack(std::int64_t const* words, std::size_t count, F&& f) {
    if (count == 0) return words;
    BitColumns const format(words);
    std::size_t at = 64 * header;
    for (std::size_t n = 0; n < count; ++n) {
      Row row;
      for (std::size_t c = 0; c < columns; ++c) {
        row[c] = format.least_[c] + get(words, at, format.bits_[c]);
        at += format.bits_[c];
      }
      f(row);
    }
    return words + (at + 63) / 64;
  }

 private:
  static constexpr std::size_t header = columns + (columns + 7) / 8;

  explicit BitColumns(std::vector<Row> const& rows) {
    Row most = least_ = rows.front();
    for (Row const& row : rows)
      for (std::size_t c = 0; c < columns; ++c) {
        least_[c] = std::min(least_[c], row[c]);
        most[c] = std::max(most[c], row[c]);
      }
    for (std::size_t c = 0; c < columns; ++c)
      for (std::uint64_t range = most[c] - least_[c]; range > 0; range >>= 1) ++bits_[c];
  }
  explicit BitColumns(std::int64_t const* words) {
    std::memcpy(least_.data(), words, sizeof least_);
    std::memcpy(bits_.data(), words + columns, sizeof bits_);
  }
  void write(std::int64_t* words) const {
    std::memcpy(words, least_.data(), sizeof least_);
    std::memcpy(words + columns, bits_.data(), sizeof bits_);
  }
  std::size_t row_bits() const { return std::accumulate(bits_.begin(), bits_.end(), std::size_t(0)); }

  /// The number of so many bits from a bit on.
  static std::uint64_t get(std::int64_t const* words, std::size_t at, unsigned bits) {
    if (bits == 0) return 0;
    std::size_t const word = at / 64, shift = at % 64;
    std::uint64_t out = std::uint64_t(words[word]) >> shift;
    if (shift + bits > 64) out |= std::uint64_t(words[word + 1]) << (64 - shift);
    return bits == 64 ? out : out & ((std::uint64_t(1) << bits) - 1);
  }

  Row least_;
  std::array<std::uint8_t, columns> bits_{};
};

}  // namespace amrpic
