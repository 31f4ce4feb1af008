// The one exchange of values between ranks that know what they send to each other.
#pragma once

#include <cstdint>
#include <exception>
#include <string>
#include <vector>

#include "base/communicator.hpp"

namespace amrpic {

/// How many values pass between this rank and another one for one purpose.
struct Parcel {
  int rank;
  std::int64_t values;
};

/// Values that readers get from owners, or owners from readers, in parcels: all those of two ranks are one message.
/// What fails on the way cannot be raised on all ranks, and ends the job with one sentence.
///
/// A call allocates nothing after the first with as many fields.
template <class T>
class Exchange {
 public:
  Exchange() : comm_(MPI_COMM_SELF) {}

  /// The parcels that other ranks read of this one, and those that it reads of them; in ascending order of ranks, and
  /// those of two ranks in the same order on both. Local.
  Exchange(Communicator const& comm, std::vector<Parcel> const& asked, std::vector<Parcel> const& wanted)
      : comm_(comm), asked_(asked), wanted_(wanted) {}

  /// From owners to readers: pack(n, out) writes the values of each asked parcel, unpack(n, in) takes those of each
  /// wanted one. `fields`: by how much to multiply the numbers of values. Collective.
  template <class Pack, class Unpack>
  void update(Pack&& pack, Unpack&& unpack, std::size_t fields = 1) const {
    start(pack, fields);
    finish(unpack);
    settle();
  }
  /// From readers to owners: wanted parcels are packed, asked ones unpacked. Collective.
  template <class Pack, class Unpack>
  void fold(Pack&& pack, Unpack&& unpack, std::size_t fields = 1) const {
    guarded([&] { wanted_.send(comm_, messages_, pack, fields), asked_.receive(comm_, messages_, fields); });
    guarded([&] { messages_.wait_for_received(), asked_.unpack(unpack); });
    settle();
  }

  /// `update` in three steps: after `start` what was packed may change, after `finish` all is unpacked, and after
  /// `settle` others have what this rank sent. Messages of other exchanges may pass meanwhile. Whoever computes in
  /// between calls `poll` at times.
  template <class Pack>
  void start(Pack&& pack, std::size_t fields = 1) const {
    guarded([&] { asked_.send(comm_, messages_, pack, fields), wanted_.receive(comm_, messages_, fields); });
  }
  void poll() const { messages_.poll(); }
  /// Does not wait for what this rank sent: others receive it when they need it, and a rank that waited for that would
  /// compute after them, not at the same time.
  template <class Unpack>
  void finish(Unpack&& unpack) const {
    guarded([&] { messages_.wait_for_received(), wanted_.unpack(unpack); });
  }
  void settle() const { messages_.wait_for_sent(); }

  std::size_t bytes() const { return asked_.bytes() + wanted_.bytes(); }  ///< of buffers on this rank

 private:
  /// One direction: its parcels, and the messages that they make up.
  class Side {
   public:
    Side() = default;
    explicit Side(std::vector<Parcel> const& parcels) {
      for (Parcel const& parcel : parcels) {
        if (messages_.empty() || messages_.back().rank != parcel.rank) messages_.push_back({parcel.rank, 0});
        messages_.back().values += parcel.values;
        first_.push_back(all_);
        all_ += parcel.values;
      }
    }
    template <class Pack>
    void send(Communicator const& comm, Messages& messages, Pack&& pack, std::size_t fields) const {
      make_room(fields);
      for (std::size_t n = 0; n < first_.size(); ++n) pack(n, buffer_.data() + std::size_t(first_[n]) * fields);
      T const* at = buffer_.data();
      for (Parcel const& m : messages_) {
        messages.send(comm, at, std::size_t(m.values) * fields, m.rank);
        at += std::size_t(m.values) * fields;
      }
    }
    void receive(Communicator const& comm, Messages& messages, std::size_t fields) const {
      make_room(fields);
      T* at = buffer_.data();
      for (Parcel const& m : messages_) {
        messages.receive(comm, at, std::size_t(m.values) * fields, m.rank);
        at += std::size_t(m.values) * fields;
      }
    }
    template <class Unpack>
    void unpack(Unpack&& unpack) const {
      for (std::size_t n = 0; n < first_.size(); ++n)
        unpack(n, static_cast<T const*>(buffer_.data() + std::size_t(first_[n]) * fields_));
    }
    std::size_t bytes() const { return buffer_.capacity() * sizeof(T); }

   private:
    void make_room(std::size_t fields) const {
      fields_ = fields;
      if (buffer_.size() < std::size_t(all_) * fields) buffer_.resize(std::size_t(all_) * fields);
    }
    std::vector<Parcel> messages_;
    std::vector<std::int64_t> first_;  ///< value of each parcel
    std::int64_t all_ = 0;
    mutable std::vector<T> buffer_;
    mutable std::size_t fields_ = 1;
  };

  template <class F>
  void guarded(F&& f) const {
    try {
      f();
    } catch (std::exception const& e) {
      comm_.abort(std::string("an exchange between ranks failed: ") + e.what());
    }
  }

  Communicator comm_;
  Side asked_, wanted_;
  mutable Messages messages_;
};

}  // namespace amrpic
