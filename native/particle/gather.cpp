#include "particle/gather.hpp"

#include "particle/array_pool.hpp"
#include "particle/read_field.hpp"

namespace amrpic {

void gather(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, ElectricField const& field,
            ParticleView const& particles, std::int64_t const* starts, std::array<Real*, 3> const& at_particles) {
  if (clouds.kernels)
    return read_tiles(mesh, remote, clouds.matched, field, particles, starts,
                      PortableReader(mesh, *clouds.kernels, particles, [&](TileKernels const& kernels, auto const& on) {
                        return kernels.gather(clouds.shape, particles, on, at_particles);
                      }));
  bool const far = are_far(particles.count, at_particles[0], at_particles[1], at_particles[2]);
  read_field(mesh, remote, clouds, field, particles, starts, [&](LaneGroup const& group, Components const& felt) {
    for (int d = 0; d < 3; ++d) store(at_particles[d], group, felt[d], far);
  });
  stream_end();
}

void gather_into_places(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds,
                        ElectricField const& field, ParticleView const& particles, std::int64_t const* starts,
                        CallersPlaces const& to, std::array<Real*, 3> const& out) {
  if (clouds.kernels) {
    std::size_t const count = std::size_t(particles.count);
    Scratch<Real> const x(count), y(count), z(count);
    gather(mesh, remote, clouds, field, particles, starts, {x.data(), y.data(), z.data()});
    return put_into_places({x.data(), y.data(), z.data()}, to, out);
  }
  read_field(mesh, remote, clouds, field, particles, starts, [&](LaneGroup const& group, Components const& felt) {
    for_each_bit(group.lanes, [&](int i) {
      std::int64_t const place = to.places[group.first + i];
      for (std::size_t d = 0; d < 3; ++d) out[d][place] = felt[d][i] * to.factors[d];
    });
  });
}

}  // namespace amrpic
