// Calls of CUDA 12 that CUDA 13 changed and that releases of Kokkos before 4.7 make. Included before all else.
#pragma once

#ifdef __CUDACC__
#include <cuda_runtime_api.h>

#include <cstddef>

#if CUDART_VERSION >= 13000
inline cudaError_t cudaGraphAddDependencies(cudaGraph_t graph, cudaGraphNode_t const* from, cudaGraphNode_t const* to,
                                            std::size_t count) {
  return cudaGraphAddDependencies(graph, from, to, nullptr, count);
}

inline cudaMemLocation place_of(int device) {
  cudaMemLocation out{};
  out.type = device == cudaCpuDeviceId ? cudaMemLocationTypeHost : cudaMemLocationTypeDevice;
  out.id = device;
  return out;
}

inline cudaError_t cudaMemAdvise(void const* memory, std::size_t bytes, cudaMemoryAdvise advice, int device) {
  return cudaMemAdvise(memory, bytes, advice, place_of(device));
}

inline cudaError_t cudaMemPrefetchAsync(void const* memory, std::size_t bytes, int device, cudaStream_t stream) {
  return cudaMemPrefetchAsync(memory, bytes, place_of(device), 0, stream);
}
#endif
#endif
