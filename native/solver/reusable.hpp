#pragma once

#include <memory>

namespace amrpic {

namespace freespace {
class FreeSpace;
class WallPlan;
}  // namespace freespace

struct Assembled;
class Bottom;

/// What a solver can hand on to that of another hierarchy on the same domain: the tables of free space, and from the
/// backend of compressed rows the operators of levels that stay with their neighbours, and the bottom, if its matrix is
/// the same.
struct Reusable {
  std::shared_ptr<Assembled> operators;  ///< emptied by the first solver that takes them
  std::shared_ptr<Bottom> bottom;
  std::shared_ptr<freespace::FreeSpace> free_space;
};

}  // namespace amrpic
