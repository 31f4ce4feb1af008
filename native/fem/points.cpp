#include "fem/points.hpp"

#include <algorithm>
#include <utility>

#include "base/native_lanes.hpp"

namespace amrpic::fem {

namespace {

constexpr int width_of_block = native_lane_count;

/// Elements of a part that have blocks.
Points::Filled filled_of(Points const& points, Lattice::Part const& part) {
  Points::Filled out;
  LocalIndex element = part.first_element;
  for_each_cell(part.elements, [&](Index3 cell) {
    if (points.first_block(element) < points.first_block(element + 1)) {
      for (int& i : cell) i *= points.lattice().degree();
      out.element.push_back(element);
      out.corner.push_back(LocalIndex(part.nodes.offset(cell)));
    }
    ++element;
  });
  return out;
}

}  // namespace

template <class F>
void Points::for_each_point(int width, F&& f) const {
  for (std::int64_t b = 0; b < blocks(); ++b)
    for (std::int64_t p = first_point(b), at = b * width * width_of_block; p < first_point(b + 1); ++p, ++at) f(p, at);
}

Points::Points(std::shared_ptr<Lattice const> lattice, std::vector<LocalIndex> const& element, Real const* reference,
               Real const* weight, bool gauss)
    : lattice_(std::move(lattice)), gauss_(gauss) {
  auto const sorted = std::make_shared<Sorted>();
  auto& [first_point, first_block, places, weights] = *sorted;
  std::size_t const elements = std::size_t(lattice_->elements().local_cells());
  std::vector<std::int64_t> counts(elements, 0);
  for (LocalIndex e : element) ++counts[std::size_t(e)];
  first_point.push_back(0), first_block.push_back(0);
  for (std::int64_t rest : counts) {
    for (; rest > 0; rest -= width_of_block)
      first_point.push_back(first_point.back() + std::min<std::int64_t>(rest, width_of_block));
    first_block.push_back(std::int64_t(first_point.size()) - 1);
  }
  sorted_ = sorted;
  places = blocked(reference, 3), weights = blocked(weight, 1);
  for (auto const& part : lattice_->parts()) filled_.push_back(filled_of(*this, part));
}

Points::Points(std::shared_ptr<Lattice const> lattice, Points const& same)
    : lattice_(std::move(lattice)),
      gauss_(same.gauss_ && lattice_->degree() == same.lattice().degree()),
      sorted_(same.sorted_) {
  for (auto const& part : lattice_->parts()) filled_.push_back(filled_of(*this, part));
}

BlockValues Points::blocked(Real const* values, int width) const {
  BlockValues out(std::size_t(blocks() * width * width_of_block), 0);
  for_each_point(width, [&](std::int64_t p, std::int64_t at) {
    for (int c = 0; c < width; ++c) out[std::size_t(at + c * width_of_block)] = values[p * width + c];
  });
  return out;
}

std::vector<Real> Points::unblocked(Real const* values, int width) const {
  std::vector<Real> out(std::size_t(count() * width));
  for_each_point(width, [&](std::int64_t p, std::int64_t at) {
    for (int c = 0; c < width; ++c) out[std::size_t(p * width + c)] = values[at + c * width_of_block];
  });
  return out;
}

std::size_t Points::bytes() const {
  std::size_t out = sizeof(Real) * (sorted_->place.size() + sorted_->weight.size());
  out += sizeof(std::int64_t) * (sorted_->first_point.size() + sorted_->first_block.size());
  for (auto const& filled : filled_) out += 2 * sizeof(LocalIndex) * filled.element.size();
  return out;
}

}  // namespace amrpic::fem
