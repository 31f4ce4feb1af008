// Prints the name of the set of kernels that is fastest on this processor.
#include <cstdio>

#include "processor/levels.hpp"

int main() {
  amrpic::for_each_level([](int level) { return std::printf("v%d", level) < 0; });
}
