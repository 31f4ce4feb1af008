#include "bind/bind.hpp"

NB_MODULE(_native, m) {
  m.doc() = "Native part of amrpic: meshes, operators, solver and particle kernels.";
#define AMRPIC_BIND(name) bind_##name(m);
#include "bind_list.inc"
#undef AMRPIC_BIND
}
