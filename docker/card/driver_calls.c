// The calls of the card's driver that Kokkos makes, looked up when they are made: the module loads where there is no driver, too.
#include <dlfcn.h>

enum { no_device = 100 };  // CUDA_ERROR_NO_DEVICE

static void* driver(char const* name) {
  static void* library;
  if (!library) library = dlopen("libcuda.so.1", RTLD_NOW);
  return library ? dlsym(library, name) : 0;
}

#define CALL(name, parameters, arguments)                   \
  int name parameters {                                     \
    int(*call) parameters = (int(*) parameters)driver(#name); \
    return call ? call arguments : no_device;               \
  }

CALL(cuCtxGetDevice, (int* device), (device))
CALL(cuCtxPushCurrent_v2, (void* context), (context))
CALL(cuStreamGetCtx, (void* stream, void** context), (stream, context))
