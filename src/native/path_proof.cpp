#include "path_proof.hpp"

#include <algorithm>
#include <cmath>

namespace strips {

constexpr int kHalvings = 3;           // of a piece at once: one for each of eight rows
constexpr double kExactTravel = 0.02;  // [m] an interval in which no point moves further is measured exactly
constexpr float kRoundedUp = 1.0f + 1e-6f;

PathProof::PathProof(std::shared_ptr<const Bodies> bodies, const Parts& parts, std::vector<std::int64_t> self_pairs,
                     const double* radius, const double* self_radius)
    : bodies_(bodies),
      narrow_(bodies),
      self_(bodies, self_pairs),
      parts_(parts),
      bounds_{radius, bodies->size()},
      self_radius_(self_radius),
      filter_(*bodies, parts, self_pairs, 0.0, 0.0),
      grown_(bodies->size() * kRows),
      pair_grown_(self_.size() * kRows) {
  T_.assign(static_cast<std::size_t>(bodies_->tree.joints) * 12, 0.0);
  T_[0] = T_[5] = T_[10] = 1.0;
  rows_.assign(kRows * static_cast<std::size_t>(bodies_->tree.nv), 0.0);
}

// What no joint moves is measured once, exactly.
bool PathProof::rest_is_clear(const double* row, double clearance, double self_clearance) {
  Queries ask(narrow_, {T_.data(), nullptr, 1}, parts_);
  bool placed = false;
  for (std::uint32_t g = 0; g < bodies_->size(); ++g) {
    for (std::uint32_t p = 0; p < parts_.count() && !filter_.moves(g); ++p) {
      if (!(exact({0, 0, g, p}, row, placed, ask) > clearance)) return false;
    }
  }
  for (std::uint32_t s = 0; s < self_.size(); ++s) {
    if (filter_.moves(self_.body(s, 0)) || filter_.moves(self_.body(s, 1))) continue;
    if (!(exact({0, 1, s, 0}, row, placed, ask) > self_clearance)) return false;
  }
  return true;
}

// As much of a pair's distance as is proven.
double PathProof::exact(const SphereOpen& open, const double* row, bool& placed, Queries& ask) {
  if (!placed) {
    place(bodies_->tree, row, 1, T_.data(), nullptr, 1);
    ask.forget();
    placed = true;
  }
  const Frames frames{T_.data(), nullptr, 1};
  ++queries;
  return or_deep([&] {
           return open.self ? self_.query(frames, 0, open.body) : ask.exact(0, open.body, open.other, nullptr).distance;
         }) -
         GJK_EXCESS;
}

void PathProof::prove(const double* rows, const double* v, std::size_t n, double clearance, double self_clearance,
                      int depth, bool all, std::int8_t* states) {
  const Tree& tree = bodies_->tree;
  const std::size_t nv = static_cast<std::size_t>(tree.nv), count = bodies_->size(), pairs = self_.size();
  ask_ = {rows, v, clearance, self_clearance, depth, all};
  std::fill_n(states, n - 1, std::int8_t{0});
  bool going = rest_is_clear(rows, clearance, self_clearance);
  if (!going) std::fill_n(states, n - 1, std::int8_t{1});
  travel_.assign((n - 1) * count, 0.0);
  self_travel_.assign((n - 1) * pairs, 0.0);
  for (std::size_t s = 0; s + 1 < n && going; ++s) {
    const double* move = v + s * nv;
    for (std::size_t g = 0; g < count; ++g) travel_[s * count + g] = bounds_.travel(tree, move, g);
    for (std::size_t k = static_cast<std::size_t>(tree.base_nv()); k < nv; ++k) {
      const double speed = std::abs(move[k]);
      for (std::size_t p = 0; p < pairs; ++p) self_travel_[s * pairs + p] += speed * self_radius_[k * pairs + p];
    }
  }
  todo_.clear();
  Piece now[kRows];
  for (std::size_t s = 0; s + 1 < n && going; s += kRows) {  // whole segments first, of all that moves
    const std::size_t filled = std::min<std::size_t>(kRows, n - 1 - s);
    for (std::size_t i = 0; i < filled; ++i) now[i] = {s + i, 0.0, 1.0, 0, {}, {}};
    going = look(now, filled, nullptr, states);
  }
  while (going && !todo_.empty()) {
    Piece piece = std::move(todo_.back());
    todo_.pop_back();
    if (states[piece.segment] != 0) continue;
    const double part = (piece.high - piece.low) / kRows;
    for (int i = 0; i < kRows; ++i) {
      now[i] = {piece.segment, piece.low + i * part, piece.low + (i + 1) * part, piece.depth + kHalvings, {}, {}};
    }
    going = look(now, kRows, &piece, states);
  }
  if (!going) std::fill_n(states, n - 1, std::int8_t{1});
}

// Look at pieces about their middles, at what the piece that they are of has left open. What they leave open is to be
// divided further, as long as that may help. False where nothing more is wanted.
bool PathProof::look(Piece* now, std::size_t filled, Piece* of, std::int8_t* states) {
  const Tree& tree = bodies_->tree;
  const std::size_t nv = static_cast<std::size_t>(tree.nv), count = bodies_->size(), pairs = self_.size();
  const float room = static_cast<float>(ask_.clearance - bodies_->skin) * kRoundedUp,
              own = static_cast<float>(ask_.self_clearance) * kRoundedUp;
  for (std::size_t i = 0; i < filled; ++i) {
    const std::size_t s = now[i].segment;
    const double half = 0.5 * (now[i].high - now[i].low);
    integrate(tree, ask_.rows + s * nv, ask_.v + s * nv, 0.5 * (now[i].low + now[i].high), &rows_[i * nv]);
    for (std::size_t g = 0; g < count; ++g) {
      grown_.data()[g * kRows + i] = room + static_cast<float>(half * travel_[s * count + g]) * kRoundedUp;
    }
    for (std::size_t p = 0; p < pairs; ++p) {
      pair_grown_.data()[p * kRows + i] = own + static_cast<float>(half * self_travel_[s * pairs + p]) * kRoundedUp;
    }
  }
  checks += filled;
  filter_.look_grown(rows_.data(), filled, grown_.data(), pair_grown_.data(), of == nullptr ? nullptr : &of->bodies,
                     of == nullptr ? nullptr : &of->pairs);
  Queries ask(narrow_, {T_.data(), nullptr, 1}, parts_);
  for (std::uint32_t row = 0; row < filled; ++row) {
    Piece& piece = now[row];
    const double half = 0.5 * (piece.high - piece.low);
    bool placed = false, hopeless = piece.depth + kHalvings > ask_.depth;
    for (const SphereOpen& open : filter_.open()) {
      if (open.row != row) continue;
      const std::size_t s = piece.segment;
      const double move = half * (open.self ? self_travel_[s * pairs + open.body] : travel_[s * count + open.body]);
      if (2.0 * move <= kExactTravel) {
        const double needed = open.self ? ask_.self_clearance : ask_.clearance;
        const double proven = exact(open, &rows_[row * nv], placed, ask);
        if (proven > needed + move) continue;
        hopeless = hopeless || !(proven > needed);
      }
      std::vector<std::uint32_t>& left = open.self ? piece.pairs : piece.bodies;
      if (left.empty() || left.back() != open.body) left.push_back(open.body);
    }
    if (piece.bodies.empty() && piece.pairs.empty()) continue;
    if (!hopeless) {
      todo_.push_back(std::move(piece));
    } else {
      states[piece.segment] = 1;
      if (ask_.all) return false;
    }
  }
  return true;
}

}  // namespace strips
