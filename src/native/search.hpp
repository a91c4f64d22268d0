// A path between two configurations by two trees that grow towards each other, and its detours taken out.
#pragma once

#include <atomic>
#include <functional>

#include "validity.hpp"

namespace strips {

// Numbers by counting: equal seeds give equal numbers everywhere, in the twin as well.
struct Draws {
  std::uint64_t state;
  double next();  // in [0, 1)
};

// What is planned are the last coordinates, each times its scale; the others stay as they are at the start.
struct SearchSpace {
  std::size_t nv, first;
  std::vector<double> scale, low, high, period;  // (K): a circular one is the same a period further on; 0 where none is

  std::size_t size() const { return scale.size(); }
};

struct SearchLimits {
  double step, range;  // [m] between places that are looked at; longest motion of a tree, scaled
  std::size_t checks;  // most configurations
  double seconds;      // most time
};

// Rows (K, nv) of the corners of a path; none where the limits end the search. Two trees' searches with other numbers
// race on two cores, the second one from where the first has not been lucky for a while. The one that needs fewer
// checks wins, whichever is first: so the result does not depend on the time that they take.
std::vector<double> found_path(Validity& valid, const SearchSpace& space, const SearchLimits& limits,
                               std::uint64_t seed, const double* start, const double* goal, int tries);

class TreeSearch {
 public:
  // `head_start` checks count as made; it is over at the time `end` [s], and with as many checks as the other search
  // needed, `most`.
  TreeSearch(Validity& valid, const SearchSpace& space, const SearchLimits& limits, std::uint64_t seed,
             const double* start, const double* goal, double end, std::size_t head_start,
             const std::atomic<std::size_t>& most);

  // Corners (n, K), scaled; `each` is called now and then.
  std::vector<double> path(const std::function<void()>& each);

  // The same with fewer corners and without detours, after so many tries at most.
  std::vector<double> shortened(std::vector<double> points, int tries);

  std::size_t spent() const { return valid_.checks - checked_before_ + head_start_; }
  std::vector<double> rows(const std::vector<double>& points) const;

 private:
  struct TreeOf {
    std::vector<float> blocks;       // (nodes / 8, K, 8), single precision, for who is nearest
    std::vector<double> at, radius;  // (nodes, K), and how far beyond a node is worth growing to
    std::vector<std::size_t> parent;
    std::size_t size() const { return parent.size(); }
  };
  bool over() const;
  void add(TreeOf& tree, const std::vector<double>& at, std::size_t parent) const;
  std::size_t nearest(const TreeOf& tree, const double* to, double& distance) const;
  void towards(const double* from, const double* to, std::vector<double>& v) const;
  const double* row(const double* at, std::vector<double>& out) const;
  bool motion(const double* a, const double* b);
  bool grown(TreeOf& tree, TreeOf& other, std::size_t& reached, std::size_t& met);
  void skip_corners(std::vector<double>& points);
  void measure(const std::vector<double>& points);
  std::size_t place(const std::vector<double>& points, double s, std::vector<double>& into);
  bool evened(std::vector<double>& middle, double first, double last, std::size_t before, double drawn);

  Validity& valid_;
  const SearchSpace& space_;
  const SearchLimits& limits_;
  const double *start_, *goal_, end_;
  const std::size_t head_start_;
  const std::atomic<std::size_t>& most_;
  Draws draws_;
  std::vector<double> one_, two_, drawn_, v_, next_, along_;
  std::size_t checked_before_;
};

}  // namespace strips
