// One function per file of this folder; the list is made by CMake from the names of the files.
#pragma once

#include <nanobind/nanobind.h>

#include "base/types.hpp"

#define AMRPIC_BIND(name) void bind_##name(nanobind::module_& m);
#include "bind_list.inc"
#undef AMRPIC_BIND

namespace nb = nanobind;
using namespace nb::literals;
using namespace amrpic;
