// The certificate's branch and bound: open intervals of pairs are halved until none is left; see certificate.py.
#pragma once

#include <algorithm>
#include <functional>

#include "proximity.hpp"

namespace strips {

// Numbered pairs that have to stay apart, and how they are measured at a node of `frames`, a place of the path.
class Pairs {
 public:
  virtual ~Pairs() = default;
  // A lower bound of the distance, or as much of it as is proven.
  virtual double measure(const Frames& frames, std::size_t node, double place, std::int64_t pair, bool exact) = 0;
  virtual double loose(std::int64_t pair) const = 0;  // how far the lower bounds may be off
  Counts counts;
};

// Pairs of a body and one of P parts, numbered body * P + part.
class ObstaclePairs : public Pairs {
 public:
  ObstaclePairs(Narrowphase& narrow, const Parts& parts, const Moving& moving)
      : narrow_(narrow), parts_(parts), moving_(moving) {}
  double measure(const Frames& frames, std::size_t node, double place, std::int64_t pair, bool exact) override;
  double loose(std::int64_t pair) const override;

 private:
  Narrowphase& narrow_;
  const Parts& parts_;
  const Moving& moving_;
};

// Pairs of the robot's own bodies; see SelfProximity.
class SelfPairs : public Pairs {
 public:
  // Distances are 0 where shapes touch, if it is shallow.
  SelfPairs(std::shared_ptr<const Bodies> bodies, std::vector<std::int64_t> pairs, bool shallow = false);
  double measure(const Frames& frames, std::size_t node, double place, std::int64_t pair, bool exact) override;
  double loose(std::int64_t pair) const override;

  // By their capsules; and signed as Coal says it: the solver then has normal and witness points.
  double lower_bound(const Frames& frames, std::size_t node, std::int64_t pair);
  double lower_bound(const std::vector<Vec3>& ends, std::int64_t pair);  // of the capsules' ends (G, 2) at a node
  double query(const Frames& frames, std::size_t node, std::int64_t pair);
  const PairSolver& solver() const { return solver_; }
  const Bodies& bodies() const { return *bodies_; }
  bool planar() const { return bodies_->tree.planar; }
  std::int64_t joint(std::size_t pair, int which) const { return bodies_->joint[pairs_[2 * pair + which]]; }
  std::size_t body(std::size_t pair, int which) const { return static_cast<std::size_t>(pairs_[2 * pair + which]); }
  std::size_t size() const { return functors_.size(); }
  std::mutex busy;  // held by the thread that is inside

 private:
  std::shared_ptr<const Bodies> bodies_;
  std::vector<std::int64_t> pairs_;  // (S, 2)
  std::vector<std::unique_ptr<ShapePair>> functors_;
  PairSolver solver_;
};

struct Interval {
  std::int64_t pair;
  double low, high, d_low, d_high, travel;
  bool exact_low, exact_high;

  // What is not a number proves nothing.
  bool open(double clearance) const { return !(d_low + d_high > travel + 2.0 * clearance); }
};

// The nearest that was found too near, or could not be decided.
struct Worst {
  bool there = false, certain = false;
  std::int64_t pair = 0;
  double place = 0.0, distance = 0.0;

  void note(double at, std::int64_t which, double d, bool sure);
};

// What distances are wanted for: intervals are open as long as they may hold one up to the clearance. Of segments with
// states, the first that is below decides one, and the others are searched on; without them it ends the search.
struct Search {
  double clearance;
  std::int8_t* states = nullptr;
  Worst worst = {};

  bool decided(double place) const { return states != nullptr && states[static_cast<std::size_t>(place)] != 0; }
  bool over() const { return states == nullptr && worst.there; }
  void found(double place, std::int64_t pair, double d);
  void unknown(const std::vector<Interval>& left);
};

// How far the two of a pair can have come nearer from one node to another.
using Approach = std::function<double(std::int64_t pair, std::size_t low, std::size_t high)>;

// A path: nodes, and the tangents (N-1, nv) from each to the next. Halves intervals along it, level by level, at most
// `depth` times; after 64 there are no more numbers in between.
class Bisection {
 public:
  Bisection(const Tree& tree, const Frames& at, const double* coordinates, const double* v, int depth)
      : frames(at), tree_(tree), coordinates_(coordinates), v_(v), depth_(std::min(depth, 64)) {}

  // What still is open then; `approach` is null where all intervals lie in one segment.
  std::vector<Interval> run(Pairs& pairs, std::vector<Interval> todo, Search& search, const Approach* approach);

  const Frames frames;
  std::size_t checks = 0;  // configurations measured between nodes

 private:
  void locate(const std::vector<double>& places);
  double measure(Pairs& pairs, double place, std::int64_t pair, bool exact) const;
  bool settle(Pairs& pairs, std::vector<Interval>& todo, Search& search, bool low);

  const Tree& tree_;
  const double *coordinates_, *v_;
  const int depth_;
  std::vector<double> T_, places_;  // placements at places between nodes, ascending
  Frames between_{nullptr, nullptr, 0};
};

// What is known of each (node, self pair): arrays (N, S), or (N, S, 3) in the base's frame; see SelfProximity.
struct SelfDistances {
  double *bound, *since, *exact, *direction, *first, *second;
  std::size_t nodes, pairs;
  double tolerance = 0.0;
};

// Of radii (nv, S), those that are not 0: most joints leave most pairs as they are.
class PairRadii {
 public:
  PairRadii(const Tree& tree, const double* radius, std::size_t pairs);
  // Bounds (S) on how far the two of each pair come nearer along a tangent or a difference of rows (nv) of one node.
  const std::vector<double>& travel(const double* from, const double* to);

 private:
  struct Entry {
    std::size_t joint;
    double radius;
  };
  std::size_t first_;               // column of the first joint: the base moves all links alike
  std::vector<std::size_t> start_;  // of each pair's entries
  std::vector<Entry> entries_;
  std::vector<double> moved_, travel_;
};

// Lower the bounds by how far the joints have moved from `before` to `coordinates` (N, nv).
void self_drift(const double* coordinates, const double* before, std::size_t nv, PairRadii& radii,
                SelfDistances& distances);

// Make exact what is below `reach` (S) and has moved by more than the tolerance since it was measured. Of what nothing
// is known yet, the node before may say enough: less how far the two can have come nearer from there.
void self_refine(SelfPairs& pairs, const Frames& frames, const double* coordinates, PairRadii& radii,
                 const double* reach, SelfDistances& distances);

// Make a single pair exact whose bound is below `reach` and may be stale.
void self_refine_at(SelfPairs& pairs, const Frames& frames, std::size_t node, std::size_t pair, double reach,
                    SelfDistances& d);

// Intervals (segment, self pair) that the nodes' distances leave open, once these have been made exact enough.
std::vector<Interval> open_self(SelfPairs& pairs, const Frames& frames, std::size_t nv, PairRadii& radii,
                                const double* v, const Search& search, SelfDistances& distances);

// A node that is itself too close decides both its segments.
void colliding_nodes(Queries& ask, Distances& distances, Search& search);

// Intervals (segment, body, part) that the nodes' distances leave open, once these have been made exact enough.
std::vector<Interval> open_obstacles(Queries& ask, const double* radius, const double* v, const double* approach,
                                     const Search& search, Distances& distances);

// Prove all pairs along a motion, from the first sample to the last; what is found too near, or is left open.
Worst prove_motion(Pairs& pairs, std::size_t count, Bisection& bisection, std::size_t nodes, double clearance,
                   const Approach& approach);

}  // namespace strips
