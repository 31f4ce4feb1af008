#include "kokkos/interface_cells.hpp"

#include <numeric>

#include "stencil/interface.hpp"

namespace amrpic::kokkos {

InterfaceCells::InterfaceCells(matrixfree::InterfaceCells const& plan, matrixfree::Layout const& layout) {
  std::vector<matrixfree::InterfaceSteps> sides;
  std::vector<Face> faces;
  GapTerms::Lists coarse_terms, fine_terms;
  std::vector<std::int32_t> places;  // of all cells, for windows
  if (!plan.gaps_.empty()) {
    places.resize(layout.size());
    std::iota(places.begin(), places.end(), 0);
  }
  std::vector<matrixfree::MetalSteps> beside_metal;
  GapTerms::Lists metal_terms;
  std::size_t gaps = 0;
  for (int direction = 0; direction < 6; ++direction) {
    of_direction_[std::size_t(direction)].first = std::int32_t(faces.size());
    for (auto const& side : plan.faces_) {
      if (2 * side.axis + side.side != direction) continue;
      auto const [axis_u, axis_v] = tangential_axes(side.axis);
      GapWindow<std::int32_t> window;
      if (side.gaps > 0) window.set_box(side.window);
      for (std::size_t p = side.first_part; p < side.first_part + side.parts; ++p)
        window.copy_in(plan.parts_[p].part, &places[std::size_t(plan.parts_[p].from.origin)],
                       plan.parts_[p].from.pitch_y, plan.parts_[p].from.pitch_z);
      std::size_t gap = side.first_gap;
      for (int v = 0; v < side.nv; ++v)
        for (int u = 0; u < side.nu; ++u) {
          FitNumber const fit = plan.fits_[side.fits + std::size_t(u + v * side.nu)];
          if (fit == no_fit) continue;
          Face face{std::int32_t(sides.size()), std::int32_t(side.cell + 2 * u * side.cell_u + 2 * v * side.cell_v),
                    std::int32_t(side.parent + u * side.parent_u + v * side.parent_v), fit};
          if (fit == fit_in_gap) {
            face.fit = ~std::int32_t(gaps++);
            Index3 child = side.first_child;
            child[axis_u] += 2 * u, child[axis_v] += 2 * v;
            for (auto const& term : plan.gaps_[gap]->terms) {
              auto const& o = term.offset;
              auto const place = term.fine ? window(child, term)
                                           : std::int32_t(face.parent + o[std::size_t(axis_u)] * side.parent_u +
                                                          o[std::size_t(axis_v)] * side.parent_v +
                                                          o[std::size_t(side.axis)] * side.parent_normal);
              (term.fine ? fine_terms : coarse_terms).terms.push_back({place, term.weight});
            }
            coarse_terms.end_gap(), fine_terms.end_gap();
            ++gap;
          }
          faces.push_back(face);
        }
      sides.push_back(side);
    }
    of_direction_[std::size_t(direction)].last = std::int32_t(faces.size());
    beside_metal_[std::size_t(direction)].first = std::int32_t(beside_metal.size());
    for (auto const& side : plan.metal_) {
      if (side.direction != direction) continue;
      beside_metal.push_back(side);
      for (auto const& [place, weight] : side.terms) metal_terms.terms.push_back({place, weight});
      metal_terms.end_gap();
    }
    beside_metal_[std::size_t(direction)].last = std::int32_t(beside_metal.size());
  }
  lists_ = {on_device(sides),        on_device(faces),     NumberedFits::made(),
            GapTerms(coarse_terms),  GapTerms(fine_terms), Array<FourStars<float>>("taken", gaps),
            on_device(beside_metal), GapTerms(metal_terms)};
}

void InterfaceCells::subtract_coarse(Array<float> const& coarse_values, Array<float> const& r) const {
  Lists const on = lists_;
  for_each_face(
      "take ghosts", KOKKOS_LAMBDA(std::int32_t n) {
        Face const& face = on.faces(n);
        matrixfree::InterfaceSteps const& side = on.sides(face.side);
        FourStars<float> stars{};
        if (face.fit >= 0)
          stars = on.fits.stars(face.fit, &coarse_values(face.parent), side.parent_u, side.parent_v);
        else
          on.coarse_terms.add(~face.fit, stars, [&](std::int32_t place) { return coarse_values(place); });
        side.subtract_ghosts(stars, &r(face.cell));
      });
  for_each_beside_metal(
      "take ghosts beside metal", KOKKOS_LAMBDA(std::int32_t n) {
        FourStars<float> stars{};
        on.metal_terms.add(n, stars, [&](std::int32_t place) { return coarse_values(place); });
        on.beside_metal(n).subtract_ghosts(stars, r.data());
      });
}

void InterfaceCells::subtract_in_gaps(Array<float> const& e, Array<float> const& r) const {
  Lists const on = lists_;
  for_each_face(
      "take ghosts in gaps", KOKKOS_LAMBDA(std::int32_t n) {
        Face const& face = on.faces(n);
        if (face.fit >= 0) return;
        FourStars<float> stars{};
        on.fine_terms.add(~face.fit, stars, [&](std::int32_t place) { return e(place); });
        on.sides(face.side).change_ghosts(stars, on.taken(~face.fit), &r(face.cell));
      });
}

void InterfaceCells::subtract_flux(Array<float> const& e, Array<float> const& coarse_values) const {
  Lists const on = lists_;
  for_each_face(
      "take fluxes", KOKKOS_LAMBDA(std::int32_t n) {
        Face const& face = on.faces(n);
        matrixfree::InterfaceSteps const& side = on.sides(face.side);
        coarse_values(face.parent) -= side.flux(&e(face.cell));
        if (face.fit < 0) coarse_values(face.parent) += side.flux_of_ghosts(on.taken(~face.fit));
      });
  for_each_beside_metal(
      "take fluxes beside metal",
      KOKKOS_LAMBDA(std::int32_t n) { coarse_values(on.beside_metal(n).parent) -= on.beside_metal(n).flux(e.data()); });
}

std::size_t InterfaceCells::bytes() const {
  return lists_.faces.extent(0) * sizeof(Face) + lists_.sides.extent(0) * sizeof(matrixfree::InterfaceSteps) +
         lists_.coarse_terms.bytes() + lists_.fine_terms.bytes() + lists_.taken.extent(0) * sizeof(FourStars<float>) +
         lists_.beside_metal.extent(0) * sizeof(matrixfree::MetalSteps) + lists_.metal_terms.bytes();
}

}  // namespace amrpic::kokkos
