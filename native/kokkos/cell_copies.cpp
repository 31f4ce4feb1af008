#include "kokkos/cell_copies.hpp"

#include <algorithm>

namespace amrpic::kokkos {

Gather::Gather(std::vector<std::pair<std::int32_t, std::int32_t>> pairs, bool adds_up) {
  std::stable_sort(pairs.begin(), pairs.end(), [](auto const& a, auto const& b) { return a.first < b.first; });
  std::vector<std::int32_t> to, first, from;
  for (auto const& [place, source] : pairs) {
    if (to.empty() || to.back() != place) {
      to.push_back(place);
      first.push_back(std::int32_t(from.size()));
    } else if (!adds_up) {
      continue;
    }
    from.push_back(source);
  }
  first.push_back(std::int32_t(from.size()));
  to_ = on_device(to), first_ = on_device(first), from_ = on_device(from);
}

void Gather::run(Array<float> const& values, Array<float> const& out, bool add) const {
  auto const to = to_, first = first_, from = from_;
  for_each(
      "copy cells", to, KOKKOS_LAMBDA(std::int32_t n) {
        float sum = add ? out(to(n)) : 0;
        for (std::int32_t t = first(n); t < first(n + 1); ++t) sum += values(from(t));
        out(to(n)) = sum;
      });
}

CellCopies::Side CellCopies::side(std::vector<Parcel> const& parcels) {
  Side out;
  std::size_t all = 0;
  for (Parcel const& parcel : parcels) {
    out.first.push_back(all);
    out.values.push_back(std::size_t(parcel.values));
    all += std::size_t(parcel.values);
  }
  out.buffer = Array<float>("values that pass", all);
  out.host = Kokkos::create_mirror_view(out.buffer);
  return out;
}

CellCopies::CellCopies(Communicator const& comm, cycle::RectangleExchange const& plan, Use use) {
  auto const lists = plan.lists();
  auto const turned = [](auto pairs) {
    for (auto& [to, from] : pairs) std::swap(to, from);
    return pairs;
  };
  bool const updates = use == Use::update;
  local_ = Gather(updates ? turned(lists.local) : lists.local, !updates);
  pack_ = Gather(turned(updates ? lists.asked : lists.wanted), !updates);
  unpack_ = Gather(updates ? lists.wanted : lists.asked, !updates);
  sent_ = side(updates ? lists.asked_parcels : lists.wanted_parcels);
  received_ = side(updates ? lists.wanted_parcels : lists.asked_parcels);
  exchange_ = Exchange<float>(comm, lists.asked_parcels, lists.wanted_parcels);
}

namespace {

template <class Side>
auto sender(Side const& side) {
  copy_values(side.host, side.buffer);
  return [&side](std::size_t n, float* out) { std::copy_n(side.host.data() + side.first[n], side.values[n], out); };
}
template <class Side>
auto receiver(Side const& side) {
  return [&side](std::size_t n, float const* in) { std::copy_n(in, side.values[n], side.host.data() + side.first[n]); };
}

}  // namespace

void CellCopies::update(Array<float> const& cells, Array<float> const& copies) const {
  pack_.set(cells, sent_.buffer);
  exchange_.start(sender(sent_));
  local_.set(cells, copies);
  exchange_.finish(receiver(received_));
  exchange_.settle();
  copy_values(received_.buffer, received_.host);
  unpack_.set(received_.buffer, copies);
}

void CellCopies::add(Array<float> const& copies, Array<float> const& cells) const {
  local_.add(copies, cells);
  pack_.set(copies, sent_.buffer);
  exchange_.fold(sender(sent_), receiver(received_));
  copy_values(received_.buffer, received_.host);
  unpack_.add(received_.buffer, cells);
}

std::size_t CellCopies::bytes() const {
  return exchange_.bytes() + (sent_.buffer.extent(0) + received_.buffer.extent(0)) * sizeof(float) + local_.bytes() +
         pack_.bytes() + unpack_.bytes();
}

}  // namespace amrpic::kokkos
