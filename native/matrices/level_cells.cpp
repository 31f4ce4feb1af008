#include "matrices/level_cells.hpp"

#include <numeric>
#include <tuple>

namespace amrpic {

LevelCells::LevelCells(Communicator const& comm, std::shared_ptr<Level const> level, Halo halo)
    : level_(std::move(level)), halo_(std::move(halo)), place_(std::size_t(halo_.size())), swept_(halo_.size()) {
  std::iota(place_.begin(), place_.end(), rows());
  auto maps = map_all(comm);
  maps.swept = maps.all, maps.to_swept = maps.to_all;
  maps_ = UntilFinalize<Maps>(std::move(maps));
}

LevelCells::LevelCells(Communicator const& comm, std::shared_ptr<Level const> level, Halo halo, CellReads const& swept)
    : level_(std::move(level)), halo_(std::move(halo)), place_(std::size_t(halo_.size())) {
  std::vector<char> is_swept(place_.size(), 0);
  for (NumberRun const& run : swept.wanted())
    for (LocalIndex n = 0; n < run.count; ++n) is_swept[std::size_t(halo_.local(run.first + n) - rows())] = 1;
  swept_ = std::accumulate(is_swept.begin(), is_swept.end(), LocalIndex(0));
  LocalIndex first = rows(), other = rows() + swept_;
  for (std::size_t n = 0; n < place_.size(); ++n) place_[n] = is_swept[n] ? first++ : other++;
  auto maps = map_all(comm);
  std::tie(maps.swept, maps.to_swept) = with_halo(comm, maps.own, rows() + swept_);
  maps_ = UntilFinalize<Maps>(std::move(maps));
}

LevelCells::Maps LevelCells::map_all(Communicator const& comm) const {
  Maps maps;
  maps.own = Teuchos::rcp(
      new TpetraTypes::Map(Tpetra::global_size_t(level_->cells()), std::size_t(rows()), 0, ranks_of(comm)));
  std::tie(maps.all, maps.to_all) = with_halo(comm, maps.own, columns());
  return maps;
}

/// The map of the first `count` cells that have places, and the import that fills those of the halo.
LevelCells::MapAndImport LevelCells::with_halo(Communicator const& comm,
                                               Teuchos::RCP<TpetraTypes::Map const> const& own,
                                               LocalIndex count) const {
  if (comm.ranks() == 1) return {own, Teuchos::null};
  auto const cells = numbers();
  std::vector<TpetraTypes::Global> const global(cells.begin(), cells.begin() + count);
  auto const unknown = Teuchos::OrdinalTraits<Tpetra::global_size_t>::invalid();
  Teuchos::RCP<TpetraTypes::Map const> const all = Teuchos::rcp(
      new TpetraTypes::Map(unknown, Teuchos::ArrayView<TpetraTypes::Global const>(global), 0, own->getComm()));
  return {all, Teuchos::rcp(new TpetraTypes::Import(own, all))};
}

std::vector<GlobalIndex> LevelCells::numbers() const {
  std::vector<GlobalIndex> out;
  out.resize(std::size_t(columns()));
  std::iota(out.begin(), out.begin() + rows(), level_->first_local_cell());
  auto const halo = halo_.numbers();
  for (std::size_t n = 0; n < halo.size(); ++n) out[std::size_t(place_[n])] = halo[n];
  return out;
}

ArrayOnBox<LocalIndex> LevelCells::places(Box const& region) const {
  auto out = halo_.places(*level_, region);
  if (swept_ != halo_.size())
    for (LocalIndex& place : out.values())
      if (place >= rows()) place = place_[std::size_t(place - rows())];
  return out;
}

LevelVector::LevelVector(std::shared_ptr<LevelCells const> cells) : cells_(std::move(cells)) {
  auto const& maps = cells_->maps();
  Vectors out;
  using Values = TpetraTypes::MultiVector::dual_view_type::t_dev;
  auto const values = unset_array<Values>(std::size_t(cells_->columns()), std::size_t(1));
  Kokkos::deep_copy(values, 0);
  out.all = Teuchos::rcp(new TpetraTypes::MultiVector(maps.all, values));
  out.own = out.all->offsetViewNonConst(maps.own, 0);
  out.swept = out.all->offsetViewNonConst(maps.swept, 0);
  vectors_ = UntilFinalize<Vectors>(std::move(out));
}

// Restricted: own cells, which source and target share, stay as they are.
void LevelVector::update_halo() {
  auto const& import = cells_->maps().to_all;
  if (!import.is_null()) all().doImport(own(), *import, Tpetra::INSERT, true);
}

void LevelVector::update_swept_halo() {
  auto const& import = cells_->maps().to_swept;
  if (!import.is_null()) vectors_->swept->doImport(own(), *import, Tpetra::INSERT, true);
}

}  // namespace amrpic
