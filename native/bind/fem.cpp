#include <nanobind/ndarray.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/unique_ptr.h>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "fem/basis.hpp"
#include "fem/moments.hpp"
#include "fem/operators.hpp"
#include "solver/node_equations.hpp"
#include "solver/node_rows.hpp"

namespace {

using Elements = nb::ndarray<LocalIndex const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<bool const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

/// Indices (n, 3) of this rank's cells of a level, in their order.
nb::ndarray<nb::numpy, int> indices_of(Level const& level) {
  std::vector<int> out;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    for_each_cell(level.box(b), [&](Index3 const& cell) { out.insert(out.end(), cell.begin(), cell.end()); });
  return bind::to_array(std::move(out), {std::size_t(level.local_cells()), 3});
}

/// Finds the elements of places.
class ElementFinder {
 public:
  explicit ElementFinder(Hierarchy const& hierarchy) : domain_(hierarchy.domain()), level_(hierarchy.level(0)) {
    for (std::size_t d = 0; d < 3; ++d) per_length_[d] = 1 / domain_.spacing(d);  // rounded as where points migrate
  }

  /// The element of a place, which may lie on the domain's upper faces; -1 if another rank has it, or none.
  LocalIndex operator()(Real const* place, Real* reference) {
    Index3 cell;
    for (std::size_t d = 0; d < 3; ++d) {
      if (!(place[d] >= domain_.lower[d] && place[d] <= domain_.upper[d])) return -1;
      Real const at = (place[d] - domain_.lower[d]) * per_length_[d];
      cell[d] = std::min(int(at), domain_.cells[d] - 1);
      reference[d] = 2 * (at - cell[d]) - 1;
    }
    if (!level_.box(box_).contains(cell)) box_ = level_.find(cell);
    if (level_.owner(box_) != level_.rank()) return -1;
    return level_.local_offset(box_) + LocalIndex(level_.box(box_).offset(cell));
  }

 private:
  Domain const& domain_;
  Level const& level_;
  Real3 per_length_;
  int box_ = 0;  ///< of the last place, where the next one mostly is too
};

/// 1 where unknowns are free, 0 where they are fixed.
std::vector<Real> free_of(Flags const& fixed) {
  std::vector<Real> out;
  for (std::size_t i = 0; i < fixed.size(); ++i) out.push_back(!fixed.data()[i]);
  return out;
}

/// An operator's function of vectors of so many values, without the interpreter.
template <class F>
nb::ndarray<nb::numpy, Real> computed(F&& f) {
  auto out = bind::released(f);
  return bind::to_array(std::move(out));
}

}  // namespace

void bind_fem(nb::module_& m) {
  m.def(
      "fem_gauss_rule",
      [](int count) {
        auto rule = fem::gauss_rule(count);
        return nb::make_tuple(bind::to_array(std::move(rule.place)), bind::to_array(std::move(rule.weight)));
      },
      "count"_a, "Places and weights of Gauss's rule on [-1, 1].");
  m.def(
      "fem_lobatto_nodes", [](int degree) { return bind::to_array(fem::lobatto_nodes(degree)); }, "degree"_a,
      "Nodes of an element along an axis, from -1 to 1.");
  m.def(
      "fem_fit_moments",
      [](bind::Starts first, bind::RealRows reference, bind::Reals volume, Flags full, Real element_volume,
         int highest) {
        auto fitted = bind::released([&] {
          return fem::fit_moments({first.data(), first.data() + first.size()}, reference.data(), volume.data(),
                                  full.data(), element_volume, highest);
        });
        return nb::make_tuple(bind::to_array(std::move(fitted.weight)), bind::to_array(std::move(fitted.degree)));
      },
      "first"_a, "reference"_a, "volume"_a, "full"_a, "element_volume"_a, "highest"_a,
      "Weights of points near their volumes, and to which degree they are exact in each element that is full.");

  nb::class_<fem::Lattice>(m, "FemLattice",
                           "Nodes of elements on the base cells of a hierarchy; amrpic.fem.Mesh has it.")
      .def(nb::init<std::shared_ptr<Hierarchy>, int>(), "hierarchy"_a, "degree"_a)
      .def("nodes", [](fem::Lattice const& l) { return indices_of(l.nodes()); })
      .def("elements", [](fem::Lattice const& l) { return indices_of(l.elements()); })
      .def(
          "locate",
          [](fem::Lattice const& l, bind::RealRows places) {
            std::vector<LocalIndex> element(places.shape(0));
            std::vector<Real> reference(places.size());
            ElementFinder find(l.hierarchy());
            for (std::size_t p = 0; p < places.shape(0); ++p)
              element[p] = find(places.data() + 3 * p, &reference[3 * p]);
            return nb::make_tuple(bind::to_array(std::move(element)),
                                  bind::to_array(std::move(reference), {places.shape(0), 3}));
          },
          "places"_a, "The element of each place among this rank's, or -1, and where in it.");

  nb::class_<fem::Points>(m, "FemPoints", "Integration points; amrpic.fem.Points has them.")
      .def(
          "__init__",
          [](fem::Points* self, std::shared_ptr<fem::Lattice> const& lattice, Elements element,
             bind::RealRows reference, bind::Reals weight, bool gauss) {
            new (self) fem::Points(lattice, {element.data(), element.data() + element.size()}, reference.data(),
                                   weight.data(), gauss);
          },
          "lattice"_a, "element"_a, "reference"_a, "weight"_a, "gauss"_a)
      .def_prop_ro("bytes", &fem::Points::bytes)
      .def(
          "reference",
          [](fem::Points const& p) {
            return bind::to_array(p.unblocked(p.places(), 3), {std::size_t(p.count()), 3});
          },
          "Where points lie in their elements.")
      .def(
          "weight", [](fem::Points const& p) { return bind::to_array(p.unblocked(p.weights(), 1)); },
          "Weights of points.")
      .def(
          "values",
          [](fem::Points const& p, int components, bind::Reals u) {
            return computed([&] { return fem::values_at(p, components, u.data()); });
          },
          "components"_a, "u"_a)
      .def(
          "slopes",
          [](fem::Points const& p, int components, bind::Reals u) {
            return computed([&] { return fem::slopes_at(p, components, u.data()); });
          },
          "components"_a, "u"_a)
      .def(
          "integrals",
          [](fem::Points const& p, int components, bind::Reals values) {
            return computed([&] { return fem::integrals(p, components, values.data()); });
          },
          "components"_a, "values"_a);

  m.def("fem_mass", &fem::mass, "points"_a, "components"_a);
  m.def("fem_poisson", &fem::poisson, "points"_a, "components"_a);
  nb::class_<NodeMultigrid>(m, "FemMultigrid", "A preconditioner that solves of operators near each other share.");
  auto const product = [](auto apply) {
    return [apply](fem::Operator const& a, bind::Reals u) {
      return computed([&] {
        std::vector<Real> v(a.unknowns());
        (a.*apply)(u.data(), v.data());
        return v;
      });
    };
  };
  nb::class_<fem::Operator>(m, "FemOperator", "An operator at points; amrpic.fem has those of mass and of Poisson.")
      .def("apply", product(&fem::Operator::apply), "u"_a)
      .def("apply_nearly", product(&fem::Operator::apply_nearly), "u"_a,
           "The product as smoothers have it, in single precision where there is such a form.")
      .def("diagonal", [](fem::Operator const& a) { return computed([&] { return a.diagonal(); }); })
      .def("entries",
           [](fem::Operator const& a) {
             auto found = a.entries();
             return nb::make_tuple(bind::to_array(std::move(found.row)), bind::to_array(std::move(found.column)),
                                   bind::to_array(std::move(found.value)));
           })
      .def(
          "corner_rows",
          [](fem::Operator const& a, Flags fixed) {
            SharedRows rows = compressed(fem::node_blocks(a, free_of(fixed)));
            std::vector<std::int64_t> start(rows.row_start.begin(), rows.row_start.end());
            return nb::make_tuple(bind::to_array(std::move(start)), bind::to_array(std::move(rows.column)),
                                  bind::to_array(std::move(rows.value)));
          },
          "fixed"_a, "This rank's rows of an operator of degree 1, as the coarse level of a solve has them.")
      .def(
          "halved_rows",
          [](fem::Operator const& a, Flags fixed) {
            auto const fine = fem::node_blocks(a, free_of(fixed));
            fem::Halving const halving(a.points().lattice().comm(), fine.nodes);
            auto rows = compressed(halving.galerkin(fine));
            std::vector<std::int64_t> start(rows.row_start.begin(), rows.row_start.end());
            return nb::make_tuple(indices_of(*halving.coarse()), bind::to_array(std::move(start)),
                                  bind::to_array(std::move(rows.column)), bind::to_array(std::move(rows.value)));
          },
          "fixed"_a, "The next level's nodes of this rank, by their indices along the axes, and their rows.")
      .def(
          "solve",
          [](fem::Operator const& a, bind::Reals f, Flags fixed, bind::Reals values, int preconditioner, Real tolerance,
             int most_iterations, std::shared_ptr<NodeMultigrid> kept) {
            auto found = bind::released([&] {
              return solve_nodes(a, f.data(), fixed.data(), values.data(), NodePreconditioner(preconditioner),
                                 tolerance, most_iterations, kept);
            });
            return nb::make_tuple(bind::to_array(std::move(found.u)), bind::to_array(std::move(found.report.residuals)),
                                  found.report.curved_down, kept);
          },
          "f"_a, "fixed"_a, "values"_a, "preconditioner"_a, "tolerance"_a, "most_iterations"_a, "kept"_a = nb::none());
}
