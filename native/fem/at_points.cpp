#include "fem/at_points.hpp"

namespace amrpic::fem {

AMRPIC_AT_POINTS_OF_SLOPES()

}  // namespace amrpic::fem
