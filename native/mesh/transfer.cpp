#include "mesh/transfer.hpp"

#include <algorithm>

#include "mesh/means.hpp"

namespace amrpic {

namespace {

/// The means that boxes of a level read of finer ones.
Reads reads_of_means(Level const& level, Level const& finer) {
  return coarsened(reads_across_ranks(
                       level, finer, [](Box const& o) { return o.coarsen(refinement_ratio); },
                       [&](int b, auto&& read) { read(level.box(b).refine(refinement_ratio)); }),
                   refinement_ratio);
}

Families families_of(Communicator const& comm, Level const& level, LevelFaces const& faces, Level const& finer) {
  Families out;
  out.means.add(0, reads_of_means(level, finer));
  out.means.plan(comm);
  out.of_box.resize(std::size_t(finer.last_local_box() - finer.first_local_box()));
  out.is_remote.assign(faces.size(), 0);
  for (std::size_t b = 0; b < faces.size(); ++b)
    for (Overlap const& o : faces[b].covered) {
      int const number = level.first_local_box() + int(b);
      Index3 const pitch = faces[b].box.strides(), parents{o.part.extent(0), o.part.extent(1), o.part.extent(2)};
      auto const parent = std::int32_t(level.local_offset(number) + faces[b].box.offset(o.part.lower));
      if (finer.owner(o.box) == finer.rank()) {
        Index3 const child = o.part.refine(refinement_ratio).shift_back(finer.box(o.box).lower).lower;
        out.of_box[std::size_t(o.box - finer.first_local_box())].push_back(
            {parent, pitch[1], pitch[2], child, parents});
      } else {
        std::int32_t const from = out.means.find(0, number, 0, o.box, o.shift, o.part).from;
        out.remote.push_back({from, parent, pitch[1], pitch[2], parents});
        out.is_remote[b] = 1;
      }
    }
  return out;
}

/// Call f(cells in a row, the row's first child in the owner's box) for the rows of parents that another rank reads.
template <class F>
void for_each_row_read(Level const& finer, Read const& read, F&& f) {
  Box const part = read.cells();
  for_each_row(part, [&](Index3 const& parent) {
    f(part.extent(0), finer.local_offset(read.owner) + finer.box(read.owner).offset(first_child_of(parent)));
  });
}

}  // namespace

Transfer::Transfer(std::shared_ptr<Hierarchy const> hierarchy) : hierarchy_(std::move(hierarchy)) {
  for (int l = 0; hierarchy_->has_finer(l); ++l)
    families_.push_back(
        families_of(hierarchy_->comm(), hierarchy_->level(l), hierarchy_->faces(l), hierarchy_->level(l + 1)));
}

/// Call f(number of parents, place of the first one, place of its first child) for the rows of parents on this rank
/// whose children lie in planes k and k + 1 of a box.
template <class F>
void Transfer::for_each_row_of_pair(int level, int b, int k, F&& f) const {
  Level const& finer = hierarchy_->level(level);
  int const number = finer.first_local_box() + b;
  std::ptrdiff_t const y = finer.box(number).stride(1), z = finer.box(number).stride(2);
  for (Family const& family : families_[std::size_t(level - 1)].of_box[std::size_t(b)]) {
    int const plane = (k - family.child[2]) / 2;
    if (k < family.child[2] || plane >= family.parents[2]) continue;
    std::ptrdiff_t parent = family.parent + std::ptrdiff_t(plane) * family.pitch_z;
    std::ptrdiff_t child = finer.local_offset(number) + family.child[0] + family.child[1] * y + k * z;
    for (int j = 0; j < family.parents[1]; ++j, parent += family.pitch_y, child += 2 * y)
      f(family.parents[0], parent, child);
  }
}

void Transfer::average_pair(int level, int b, int k, Field& field) const {
  Box const& box = hierarchy_->level(level).box(hierarchy_->level(level).first_local_box() + b);
  std::ptrdiff_t const y = box.stride(1), z = box.stride(2);
  Real const* const fine = field.level(level).data();
  Real* const coarse = field.level(level - 1).data();
  for_each_row_of_pair(level, b, k, [&](int count, std::ptrdiff_t parent, std::ptrdiff_t child) {
    average_children(count, fine + child, y, z, coarse + parent);
  });
}

void Transfer::send_means(int level, std::vector<Field*> const& fields) const {
  Level const& finer = hierarchy_->level(level);
  families_[std::size_t(level - 1)].means.start(
      [&](int, Read const& read, Real* out) {
        Box const& box = finer.box(read.owner);
        for (Field const* field : fields)
          for_each_row_read(finer, read, [&](int count, GlobalIndex child) {
            average_children(count, field->level(level).data() + child, box.stride(1), box.stride(2), out);
            out += count;
          });
      },
      fields.size());
}

void Transfer::take_means(int level, std::vector<Field*> const& fields) const {
  Families const& families = families_[std::size_t(level - 1)];
  families.means.finish();
  for (RemoteFamily const& family : families.remote) {
    std::ptrdiff_t const cells = std::ptrdiff_t(family.parents[0]) * family.parents[1] * family.parents[2];
    for (std::size_t f = 0; f < fields.size(); ++f) {
      // of several fields those of a read come one after the other
      Real const* const means =
          families.means.values() + std::ptrdiff_t(fields.size() - 1) * family.from + std::ptrdiff_t(f) * cells;
      Real* const coarse = fields[f]->level(level - 1).data();
      family.for_each_row([&](std::ptrdiff_t from, std::ptrdiff_t parent) {
        std::copy_n(means + from, family.parents[0], coarse + parent);
      });
    }
  }
}

void Transfer::settle() const {
  for (Families const& families : families_) families.means.settle();
}

void Transfer::average_down(std::vector<Field*> const& fields) const {
  for (int l = int(families_.size()); l > 0; --l) {
    for (int b = 0; b < int(families_[std::size_t(l - 1)].of_box.size()); ++b)
      for (int k = 0; k < hierarchy_->level(l).box(hierarchy_->level(l).first_local_box() + b).extent(2); k += 2)
        for (Field* field : fields) average_pair(l, b, k, *field);
    send_means(l, fields);
    take_means(l, fields);
  }
  settle();
}

void Transfer::spread(Field& field) const {
  for (int l = 1; l <= int(families_.size()); ++l) {
    Families const& families = families_[std::size_t(l - 1)];
    Level const& finer = hierarchy_->level(l);
    Real const* const coarse = field.level(l - 1).data();
    Real* const fine = field.level(l).data();
    for (int b = finer.first_local_box(); b < finer.last_local_box(); ++b)
      for (int k = 0; k < finer.box(b).extent(2); k += 2)
        for_each_row_of_pair(
            l, b - finer.first_local_box(), k, [&](int count, std::ptrdiff_t parent, std::ptrdiff_t child) {
              add_to_children(count, coarse + parent, finer.box(b).stride(1), finer.box(b).stride(2), fine + child);
            });
    std::vector<Real> values(std::size_t(families.means.size()));
    for (RemoteFamily const& family : families.remote)
      family.for_each_row([&](std::ptrdiff_t from, std::ptrdiff_t parent) {
        std::copy_n(coarse + parent, family.parents[0], values.data() + from);
      });
    families.means.fold(values.data(), [&](int, Read const& read, Real const* in) {
      Box const& box = finer.box(read.owner);
      for_each_row_read(finer, read, [&](int count, GlobalIndex child) {
        add_to_children(count, in, box.stride(1), box.stride(2), fine + child);
        in += count;
      });
    });
  }
}

std::size_t Transfer::bytes() const {
  std::size_t sum = 0;
  for (Families const& families : families_) {
    for (auto const& of_box : families.of_box) sum += sizeof of_box + of_box.capacity() * sizeof(Family);
    sum += families.remote.capacity() * sizeof(RemoteFamily) + families.is_remote.capacity() + families.means.memory();
  }
  return sum;
}

}  // namespace amrpic
