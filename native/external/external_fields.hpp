// The fields of the elements of a beam line.
#pragma once

#include <variant>
#include <vector>

#include "external/field_map.hpp"
#include "external/flight.hpp"

namespace amrpic {

namespace external {

typedef std::variant<Uniform, Focusing, Quadrupole, Dipole, Multipole, Solenoid, Gap, Pillbox, FieldMap> Kind;

/// Axes of an element: where its origin is, and its unit vectors along x, y, z in those of the laboratory.
struct Frame {
  Real3 origin;
  std::array<Real3, 3> axis;

  bool is_turned() const { return axis != std::array<Real3, 3>{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}; }
};

/// A kind of field somewhere; outside its extent in its own axes, and farther from its z than its reach, it is zero.
struct Element {
  Frame frame;
  Slab extent;
  Kind kind;
  Real reach;  ///< m; may be infinite
};

/// Places, eight at a time, and what is there.
struct Places {
  static constexpr std::size_t most = 8;
  std::array<Vector3<Lanes>, most> x, E, B;  ///< m, V/m, T
  std::array<Lanes, most> near_end;  ///< 1 where a hard end may be within reach, so that fields differ along a flight
  std::size_t count = 0;             ///< of eights
};

/// Where a field can be, along the laboratory's z.
Interval laboratory_extent(Element const& element);

}  // namespace external

/// Elements in the order in which they begin along z; where they overlap, fields add.
class ExternalFields {
 public:
  ExternalFields() = default;
  explicit ExternalFields(std::vector<external::Element> elements);

  /// The same fields in coordinates whose origin and axes are these in the present ones.
  ExternalFields seen_from(external::Frame const& frame) const;

  bool empty() const { return entries_.empty(); }
  bool electric() const { return electric_; }  ///< whether any element has such a field
  bool magnetic() const { return magnetic_; }

  /// Add the fields at places to what is there; set which are nearer to a hard end than `reach` (m). Return whether any
  /// is.
  bool add_field(Real time, Real reach, external::Places& at) const;

  /// Call f(element, whether it is turned) for those that may have a field between two z.
  template <class F>
  void for_each_near(Real lower, Real upper, F&& f) const {
    for (std::size_t n = first_near(lower); n < entries_.size() && entries_[n].z.lower <= upper; ++n)
      if (entries_[n].z.upper >= lower) f(entries_[n].element, entries_[n].turned);
  }

 private:
  struct Entry {
    external::Element element;
    external::Interval z;  ///< of the laboratory
    Real highest;          ///< upper end of this one and those before
    bool turned;
  };
  std::size_t first_near(Real lower) const;

  std::vector<Entry> entries_;
  bool electric_ = false, magnetic_ = false;
};

/// Add the mean of all fields along a flight, in V/m and T, for a `Real`, or for eight flights as `Lanes`; and apart
/// from it what is in planes alone.
///
/// A field that ends at planes is taken in the middle of the part of the flight between these, and at the time of that
/// middle, times the share of that part. Other fields are those at x, at the flight's time. A flight without length
/// gives the field at a point.
///
/// What is in planes turns a momentum at once, where other fields do so along the flight. So a step of second order
/// turns by `first`, then by E and B, then by `last` times |v · normal| before over that now: a flight gets more of
/// what it crosses slowly. It shifts x by minus the change of v times when that was, since the drift has the new
/// velocity from the plane on.
///
/// Where `ends` is 0, both halves of a flight from -t to t may take its mean, which is that at x.
template <class V>
void add_mean_field(ExternalFields const& fields, Flight<V> const& flight, Vector3<V>& E, Vector3<V>& B,
                    Edges<V>& edges);

/// The same with `first` and `last` in B.
template <class V>
void add_mean_field(ExternalFields const& fields, Flight<V> const& flight, Vector3<V>& E, Vector3<V>& B);

}  // namespace amrpic
