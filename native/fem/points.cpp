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
  auto const& first = sorted_->first_point;
  for (std::size_t e = 0; e + 1 < first.size(); ++e)
    for (std::int64_t p = first[e], n = 0; p < first[e + 1]; ++p, ++n)
      f(p, (sorted_->first_block[e] + n / width_of_block) * width * width_of_block + n % width_of_block);
}

Points::Points(std::shared_ptr<Lattice const> lattice, std::vector<LocalIndex> const& element, Real const* reference,
               Real const* weight, bool gauss)
    : lattice_(std::move(lattice)), gauss_(gauss) {
  auto const sorted = std::make_shared<Sorted>();
  auto& [first_point, first_block, places, weights] = *sorted;
  std::size_t const elements = std::size_t(lattice_->elements().local_cells());
  first_point.assign(elements + 1, 0);
  for (LocalIndex e : element) ++first_point[std::size_t(e) + 1];
  first_block.push_back(0);
  for (std::size_t e = 0; e < elements; ++e) {
    first_block.push_back(first_block[e] + (first_point[e + 1] + width_of_block - 1) / width_of_block);
    first_point[e + 1] += first_point[e];
  }
  sorted_ = sorted;
  auto const of_places = blocked(reference, 3), of_weights = blocked(weight, 1);
  places.assign(of_places.begin(), of_places.end());
  weights.assign(of_weights.begin(), of_weights.end());
  for (auto const& part : lattice_->parts()) filled_.push_back(filled_of(*this, part));
}

Points::Points(std::shared_ptr<Lattice const> lattice, Points const& same)
    : lattice_(std::move(lattice)),
      gauss_(same.gauss_ && lattice_->degree() == same.lattice().degree()),
      sorted_(same.sorted_) {
  for (auto const& part : lattice_->parts()) filled_.push_back(filled_of(*this, part));
}

std::vector<Real> Points::blocked(Real const* values, int width) const {
  std::vector<Real> out(std::size_t(blocks() * width * width_of_block), 0);
  for_each_point(width, [&](std::int64_t p, std::int64_t at) {
    for (int c = 0; c < width; ++c) out[std::size_t(at + c * width_of_block)] = values[p * width + c];
  });
  return out;
}

std::vector<Real> Points::blocked_of(int width, WriteValues const& f) const {
  std::vector<Real> out(std::size_t(blocks() * width * width_of_block), 0), own(std::size_t(width), 0);
  for_each_point(width, [&](std::int64_t p, std::int64_t at) {
    std::fill(own.begin(), own.end(), Real(0));
    f(std::size_t(p), own.data());
    for (int c = 0; c < width; ++c) out[std::size_t(at + c * width_of_block)] = own[std::size_t(c)];
  });
  return out;
}

std::vector<Real> Points::unblocked(std::vector<Real> const& values, int width) const {
  std::vector<Real> out(std::size_t(count() * width));
  for_each_point(width, [&](std::int64_t p, std::int64_t at) {
    for (int c = 0; c < width; ++c) out[std::size_t(p * width + c)] = values[std::size_t(at + c * width_of_block)];
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
