// The Python module: arrays and shapes in, loops without the interpreter's lock. See _native.pyi.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <coal/config.hh>

#include "certificate.hpp"
#include "lookahead.hpp"
#include "system.hpp"
#include "timing.hpp"
#include "validity.hpp"

namespace nb = nanobind;
using namespace strips;

// An array of Python's itself, to write to or to keep, and never a converted copy.
template <typename T>
struct Same : nb::ndarray<T, nb::c_contig, nb::device::cpu> {
  using Array = nb::ndarray<T, nb::c_contig, nb::device::cpu>;
  using Array::Array;
};

template <typename T>
struct nanobind::detail::type_caster<Same<T>> {
  NB_TYPE_CASTER(Same<T>, make_caster<typename Same<T>::Array>::Name)

  bool from_python(handle source, std::uint8_t flags, cleanup_list* cleanup) noexcept {
    make_caster<typename Same<T>::Array> caster;
    if (!caster.from_python(source, flags & ~static_cast<std::uint8_t>(cast_flags::convert), cleanup)) return false;
    static_cast<typename Same<T>::Array&>(value) = std::move(caster.value);
    return true;
  }
};

namespace {

template <typename T>
using In = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
using Reals = In<double>;
using Numbers = In<std::int64_t>;
using MaybeReals = std::optional<Reals>;

template <typename T, typename A>
std::vector<T> copied(const A& array) {
  return std::vector<T>(array.data(), array.data() + array.size());
}

// A new array (K,) of Python's, with what a vector has.
nb::ndarray<nb::numpy, std::int64_t> given(std::vector<std::int64_t>&& values) {
  auto* kept = new std::vector<std::int64_t>(std::move(values));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<std::int64_t>*>(p); });
  return nb::ndarray<nb::numpy, std::int64_t>(kept->data(), {kept->size()}, owner);
}

std::vector<std::uint8_t> flags(const In<bool>& array) { return copied<std::uint8_t>(array); }
std::vector<double> reals(const Reals& array) { return copied<double>(array); }
std::vector<std::int64_t> numbers(const Numbers& array) { return copied<std::int64_t>(array); }

// A function that runs without the interpreter's lock.
template <typename Scope, typename F>
void unlocked(Scope& scope, const char* name, F&& function) {
  scope.def(name, std::forward<F>(function), nb::call_guard<nb::gil_scoped_release>());
}

// The arrays T (joints, capacity, 3, 4) and J (capacity, M, 6) of a Kinematics.
Frames frames_of(const Reals& T) { return {T.data(), nullptr, T.shape(1)}; }
Frames frames_of(const Reals& T, const Reals& J) { return {T.data(), J.data(), T.shape(1)}; }

// Arrays of Python's that many calls work on; each keeps them alive.
struct PoseArrays {
  Same<const double> rotation, translation, box_center, box_half;

  PartPoses view() const {
    return {rotation.data(), translation.data(), box_center.data(), box_half.data(), rotation.shape(0)};
  }
};

struct MovingArrays {
  Reals shift, uncertainty;
  Numbers mover;

  static Moving view(const std::optional<MovingArrays>& m) {
    if (!m) return {};
    return {m->shift.data(), m->uncertainty.data(), m->mover.data(), m->uncertainty.shape(1), m->uncertainty.shape(0)};
  }
};

struct DistanceArrays {
  Same<double> bound, since, exact, direction, witness;
  Reals limit;

  Distances view() const {
    return {bound.data(), since.data(),   exact.data(),   direction.data(), witness.data(),
            limit.data(), bound.shape(0), bound.shape(1), bound.shape(2)};
  }
};

struct SelfArrays {
  Same<double> bound, since, exact, direction, first, second;
  double tolerance;

  SelfDistances view() const {
    return {bound.data(),  since.data(),   exact.data(),   direction.data(), first.data(),
            second.data(), bound.shape(0), bound.shape(1), tolerance};
  }
};

struct SystemArrays {
  Same<double> force, diagonal, upper;

  System view() const {
    return {force.data(), diagonal.data(), upper.data(), force.shape(0), static_cast<int>(force.shape(1))};
  }
};

using CountsOut = std::pair<std::size_t, std::size_t>;
CountsOut counted(const Counts& counts) { return {counts.pairs, counts.queries}; }

// (place, pair, distance, certain) of the worst place, or None; configurations measured between nodes; counts.
using Proof = std::tuple<std::optional<std::tuple<double, std::int64_t, double, bool>>, std::size_t, CountsOut>;
Proof proof(const Worst& worst, std::size_t checks, const Counts& counts) {
  if (!worst.there) return {std::nullopt, checks, counted(counts)};
  return {std::make_tuple(worst.place, worst.pair, worst.distance, worst.certain), checks, counted(counts)};
}

// Bisect what is open and not decided; what is left then is unknown.
Proof bisected(Bisection& bisection, Pairs& pairs, const std::vector<Interval>& todo, StripSearch& search, int depth,
               const Counts& before) {
  for (const Interval& x : todo) search.found(x.low, x.pair, std::min(x.d_low, x.d_high));
  std::vector<Interval> open;
  for (const Interval& x : todo) {
    if (!search.decided(x.low)) open.push_back(x);
  }
  search.unknown(bisection.run(pairs, std::move(open), search, depth, nullptr));
  const Counts all{before.pairs + pairs.counts.pairs, before.queries + pairs.counts.queries};
  return proof(search.worst, bisection.checks, all);
}

// Sums (N, K) up to each node of what happens between them (N-1, K).
std::vector<double> summed(const Reals& steps) {
  const std::size_t count = steps.shape(1);
  std::vector<double> sums((steps.shape(0) + 1) * count, 0.0);
  for (std::size_t k = count; k < sums.size(); ++k) sums[k] = sums[k - count] + steps.data()[k - count];
  return sums;
}

void bind_robot(nb::module_& m) {
  nb::class_<Solid>(m, "Solid");
  m.def("primitive", [](const std::string& kind, const std::vector<double>& size, double swept) {
    return std::make_shared<Solid>(primitive(kind, size, swept));
  });
  m.def("convex", [](Reals points, In<std::uint32_t> triangles, double swept) {
    return std::make_shared<Solid>(convex(points.data(), points.shape(0), triangles.data(), triangles.shape(0), swept));
  });
  m.def("block",
        [](Reals sides, Reals at) { return std::make_shared<Solid>(block(sides.data(), at.data(), sides.shape(0))); });

  nb::class_<Tree> tree(m, "Tree");
  tree.def("__init__",
           [](Tree* self, bool planar, Numbers parents, Numbers motion, In<bool> prismatic, In<bool> circular,
              In<bool> support, Reals offset, Numbers coordinate, Reals rate, Reals shift) {
             new (self) Tree{{static_cast<int>(circular.size()) + (planar ? 3 : 0), planar, flags(circular)},
                             static_cast<int>(parents.size()),
                             numbers(parents),
                             numbers(motion),
                             numbers(coordinate),
                             flags(prismatic),
                             flags(support),
                             reals(offset),
                             reals(rate),
                             reals(shift)};
           });
  unlocked(tree, "place", [](const Tree& tree, Reals coordinates, Same<double> T, Same<double> J, bool jacobians) {
    place(tree, coordinates.data(), coordinates.shape(0), T.data(), jacobians ? J.data() : nullptr, T.shape(1));
  });
  unlocked(tree, "directional",
           [](const Tree& tree, Reals J, Numbers node, Numbers joint, Reals point, Reals direction, Same<double> rows) {
             for (std::size_t k = 0; k < node.size(); ++k)
               add_directional(tree, J.data() + node.data()[k] * tree.motions() * 6, joint.data()[k],
                               point.data() + 3 * k, direction.data() + 3 * k, rows.data() + k * tree.nv);
           });

  nb::class_<Bodies> bodies(m, "Bodies");
  bodies.def("__init__", [](Bodies* self, const Tree& tree, const std::vector<std::shared_ptr<Solid>>& solids,
                            Numbers joint, Reals rotation, Reals translation, Reals ends, Reals radius, double skin) {
    new (self) Bodies{tree, {}, numbers(joint), reals(rotation), reals(translation), reals(ends), reals(radius), skin};
    for (const auto& solid : solids) self->solids.push_back(*solid);
  });
}

void bind_obstacles(nb::module_& m) {
  nb::class_<PoseArrays> poses(m, "Poses");
  poses.def(nb::init<Same<const double>, Same<const double>, Same<const double>, Same<const double>>());
  nb::class_<MovingArrays> moving(m, "Moving");
  moving.def(nb::init<Reals, Reals, Numbers>());
  nb::class_<DistanceArrays> distances(m, "Distances");
  distances.def(nb::init<Same<double>, Same<double>, Same<double>, Same<double>, Same<double>, Reals>());
  distances.def("contacts", [](const DistanceArrays& self, double influence) {
    const Distances d = self.view();
    std::vector<std::int64_t> node, body, part;
    for (std::size_t n = 0; n < d.nodes; ++n) {
      for (std::size_t g = 0; g < d.bodies; ++g) {
        const std::size_t first = d.index(n, g, 0);
        for (std::size_t p = 0; p < d.parts; ++p) {
          if (!(d.exact[first + p] < influence && d.since[first + p] <= d.limit[p])) continue;
          node.push_back(static_cast<std::int64_t>(n));
          body.push_back(static_cast<std::int64_t>(g));
          part.push_back(static_cast<std::int64_t>(p));
        }
      }
    }
    return std::make_tuple(given(std::move(node)), given(std::move(body)), given(std::move(part)));
  });

  nb::class_<Narrowphase> narrowphase(m, "Narrowphase");
  narrowphase.def(nb::init<std::shared_ptr<Bodies>>());
  narrowphase.def("set_parts", &Narrowphase::set_parts);
  unlocked(narrowphase, "query",
           [](Narrowphase& self, Reals T, Numbers node, Numbers body, Numbers part, const PoseArrays& poses,
              MaybeReals shift, Same<double> distance, Same<double> direction, Same<double> witness) {
             self.begin();
             const Frames frames = frames_of(T);
             const PartPoses view = poses.view();
             for (std::size_t k = 0; k < node.size(); ++k) {
               Vec3 by;
               if (shift) by = Eigen::Map<const Vec3>(shift->data() + 3 * k);
               const Found found =
                   self.query(frames, node.data()[k], body.data()[k], part.data()[k], view, shift ? &by : nullptr);
               distance.data()[k] = found.distance;
               Eigen::Map<Vec3>(direction.data() + 3 * k) = found.direction;
               Eigen::Map<Vec3>(witness.data() + 3 * k) = found.witness;
             }
           });
  unlocked(narrowphase, "refine",
           [](Narrowphase& self, Reals T, const PoseArrays& poses, const std::optional<MovingArrays>& moving,
              double influence, const DistanceArrays& distances) {
             Distances view = distances.view();
             return counted(refine(self, frames_of(T), poses.view(), MovingArrays::view(moving), influence, view));
           });
  unlocked(narrowphase, "follow",
           [](const Narrowphase& self, Reals T, Reals coordinates, double influence, Same<double> kept,
              Same<double> ends, Same<double> rotations, Reals cover_low, Reals cover_high, Same<std::int64_t> cover,
              Same<double> margin, const DistanceArrays& distances) {
             Distances view = distances.view();
             Nodes nodes{kept.data(),       ends.data(),  rotations.data(), cover_low.data(),
                         cover_high.data(), cover.data(), margin.data()};
             return follow(*self.bodies, frames_of(T), coordinates.data(), influence, nodes, view);
           });
  unlocked(narrowphase, "certify",
           [](Narrowphase& self, Reals T, Reals J, Reals coordinates, Reals v, const PoseArrays& poses,
              const std::optional<MovingArrays>& moving, Reals radius, MaybeReals approach,
              const DistanceArrays& distances, double clearance, int depth, Same<std::int8_t> states) {
             const Frames frames = frames_of(T, J);
             const PartPoses where = poses.view();
             const Moving moves = MovingArrays::view(moving);
             Distances view = distances.view();
             StripSearch search(clearance, states.data());
             Counts counts;
             colliding_nodes(self, frames, where, moves, view, states.data(), search, counts);
             const std::vector<Interval> todo =
                 open_obstacles(self, frames, where, moves, Bounds{radius.data(), view.bodies}, v.data(),
                                approach ? approach->data() : nullptr, states.data(), clearance, view, counts);
             ObstaclePairs pairs(self, where, moves);
             Bisection bisection(self.bodies->tree, frames, coordinates.data(), v.data());
             return bisected(bisection, pairs, todo, search, depth, counts);
           });
  unlocked(
      narrowphase, "prove",
      [](Narrowphase& self, Reals T, Reals coordinates, Reals v, const PoseArrays& poses,
         const std::optional<MovingArrays>& moving, Reals travel, MaybeReals approach, double clearance, int depth) {
        const Frames frames = frames_of(T);
        const PartPoses where = poses.view();
        const Moving moves = MovingArrays::view(moving);
        const std::size_t bodies = self.bodies->size(), parts = where.count;
        const std::vector<double> own = summed(travel), theirs = approach ? summed(*approach) : std::vector<double>();
        const Approach nearer = [&](std::int64_t pair, std::size_t low, std::size_t high) {
          const std::size_t g = static_cast<std::size_t>(pair) / parts, p = static_cast<std::size_t>(pair) - g * parts;
          const double sum = own[high * bodies + g] - own[low * bodies + g];
          return theirs.empty() ? sum : sum + (theirs[high * parts + p] - theirs[low * parts + p]);
        };
        ObstaclePairs pairs(self, where, moves);
        Bisection bisection(self.bodies->tree, frames, coordinates.data(), v.data());
        const Worst worst =
            prove_motion(pairs, bodies * parts, bisection, frames, coordinates.shape(0), clearance, depth, nearer);
        return proof(worst, bisection.checks, pairs.counts);
      });
}

void bind_self(nb::module_& m) {
  nb::class_<SelfArrays> selfDistances(m, "SelfDistances");
  selfDistances.def(
      nb::init<Same<double>, Same<double>, Same<double>, Same<double>, Same<double>, Same<double>, double>());
  nb::class_<SelfPairs> selfPairs(m, "SelfPairs");
  selfPairs.def("__init__", [](SelfPairs* self, std::shared_ptr<Bodies> bodies, Numbers pairs) {
    new (self) SelfPairs(bodies, numbers(pairs));
  });
  unlocked(selfPairs, "update",
           [](SelfPairs& self, Reals T, Reals coordinates, Reals before, Reals radius, double reach,
              const SelfArrays& distances) {
             SelfDistances view = distances.view();
             self.counts = {};
             self_drift(self.bodies().tree, coordinates.data(), before.data(), radius.data(), view);
             self_refine(self, frames_of(T), reach, view);
             return counted(self.counts);
           });
  unlocked(selfPairs, "query", [](SelfPairs& self, Reals T, Numbers node, Numbers pair, Same<double> distance) {
    for (std::size_t k = 0; k < node.size(); ++k) {
      distance.data()[k] = self.query(frames_of(T), node.data()[k], pair.data()[k]);
    }
  });
  unlocked(selfPairs, "certify",
           [](SelfPairs& self, Reals T, Reals coordinates, Reals v, Reals radius, const SelfArrays& distances,
              double clearance, int depth, Same<std::int8_t> states) {
             const Frames frames = frames_of(T);
             SelfDistances view = distances.view();
             StripSearch search(clearance, states.data());
             self.counts = {};
             const Tree& tree = self.bodies().tree;
             const std::vector<Interval> todo =
                 open_self(self, frames, tree, radius.data(), v.data(), states.data(), clearance, view);
             Bisection bisection(tree, frames, coordinates.data(), v.data());
             return bisected(bisection, self, todo, search, depth, {});
           });
  unlocked(selfPairs, "prove",
           [](SelfPairs& self, Reals T, Reals coordinates, Reals v, Reals travel, double clearance, int depth) {
             const Frames frames = frames_of(T);
             const std::size_t count = self.size();
             const std::vector<double> own = summed(travel);
             const Approach nearer = [&](std::int64_t pair, std::size_t low, std::size_t high) {
               return own[high * count + pair] - own[low * count + pair];
             };
             self.counts = {};
             Bisection bisection(self.bodies().tree, frames, coordinates.data(), v.data());
             const Worst worst =
                 prove_motion(self, count, bisection, frames, coordinates.shape(0), clearance, depth, nearer);
             return proof(worst, bisection.checks, self.counts);
           });
}

// A Validity and the arrays that it reads.
struct Checker {
  PoseArrays poses;
  Reals radius;
  Validity validity;
  std::vector<double> one, two, per_unit;  // a planner's chart: the last coordinates, each in units of its own

  void chart(Reals row, Reals unit) {
    one = two = reals(row);
    per_unit = reals(unit);
  }
  const double* from_chart(std::vector<double>& row, const std::vector<double>& state) const {
    if (state.size() != per_unit.size()) throw std::invalid_argument("a state of another size than the chart");
    const std::size_t first = row.size() - per_unit.size();
    for (std::size_t k = 0; k < per_unit.size(); ++k) row[first + k] = state[k] * per_unit[k];
    return row.data();
  }

  Checker(std::shared_ptr<Bodies> bodies, const std::vector<std::shared_ptr<Solid>>& parts, Numbers self_pairs,
          const PoseArrays& poses, Reals radius, double margin)
      : poses(poses),
        radius(radius),
        validity(bodies, parts, numbers(self_pairs), poses.view(), radius.data(), margin) {}
};

void bind_validity(nb::module_& m) {
  nb::class_<Checker> validity(m, "Validity");
  validity.def(nb::init<std::shared_ptr<Bodies>, const std::vector<std::shared_ptr<Solid>>&, Numbers, const PoseArrays&,
                        Reals, double>());
  validity.def("valid", [](Checker& self, Reals coordinates) { return self.validity.valid(coordinates.data()); });
  validity.def("motion", [](Checker& self, Reals a, Reals b, double step) {
    return self.validity.motion(a.data(), b.data(), step);
  });
  validity.def("chart", &Checker::chart);
  validity.def("motion_in_chart",
               [](Checker& self, const std::vector<double>& a, const std::vector<double>& b, double step) {
                 return self.validity.motion(self.from_chart(self.one, a), self.from_chart(self.two, b), step);
               });
  validity.def_prop_ro("checks", [](const Checker& self) { return self.validity.checks; });
}

void bind_system(nb::module_& m) {
  nb::class_<SystemArrays> system(m, "System");
  system.def(nb::init<Same<double>, Same<double>, Same<double>>());
  unlocked(system, "add_elastic", [](const SystemArrays& self, bool planar, Reals v, Reals weight) {
    System view = self.view();
    return add_elastic(view, planar, v.data(), weight.data());
  });
  unlocked(system, "add_repulsion",
           [](const SystemArrays& self, const Narrowphase& narrow, Reals J, const DistanceArrays& distances,
              double influence, double k_r, double near, double k_near) {
             System view = self.view();
             return add_repulsion(view, *narrow.bodies, J.data(), distances.view(), influence, k_r, near, k_near);
           });
  unlocked(system, "add_self_repulsion",
           [](const SystemArrays& self, const SelfPairs& pairs, Reals T, Reals J, const SelfArrays& distances,
              Reals repulsion, double k_s) {
             System view = self.view();
             return add_self_repulsion(view, pairs, frames_of(T, J), distances.view(), repulsion.data(), k_s);
           });
  unlocked(system, "add_posture",
           [](const SystemArrays& self, Reals coordinates, Reals target, Reals k_p, In<bool> circular) {
             System view = self.view();
             const auto* turning = reinterpret_cast<const std::uint8_t*>(circular.data());
             return add_posture(view, coordinates.data(), target.data(), k_p.data(), turning,
                                view.nv - static_cast<int>(circular.size()));
           });
  unlocked(system, "solve", [](const SystemArrays& self, Reals damping, Same<double> delta) {
    return solve(self.view(), damping.data(), delta.data());
  });
  unlocked(m, "difference", [](bool planar, In<bool> circular, Reals a, Reals b, Same<double> v) {
    const Space space{static_cast<int>(v.shape(1)), planar, flags(circular)};
    for (std::size_t k = 0; k < v.size(); k += space.nv) {
      difference(space, a.data() + k, b.data() + k, v.data() + k);
    }
  });
  unlocked(m, "integrate", [](bool planar, In<bool> circular, Reals a, Reals v, Same<double> out) {
    const Space space{static_cast<int>(v.shape(1)), planar, flags(circular)};
    for (std::size_t k = 0; k < v.size(); k += space.nv) {
      integrate(space, a.data() + k, v.data() + k, 1.0, out.data() + k);
    }
  });
  unlocked(m, "project_rolling", [](Same<double> coordinates, int iterations) {
    int taken = 0;
    const double residual = project_rolling(coordinates.data(), coordinates.shape(0),
                                            static_cast<int>(coordinates.shape(1)), iterations, taken);
    return std::make_pair(residual, taken);
  });
}

// The robot's boxes, as PlanarFootprint has them, and a view of roll-outs.
Footprint footprint_of(const Reals& middle, const Reals& half, const Reals& low, const Reals& high) {
  return {middle.data(), half.data(), low.data(), high.data(), low.size()};
}
Rollout rollout_of(const Reals& pose, const Reals& time, Same<double>& out) {
  return {pose.data(), time.data(), pose.shape(0), pose.shape(1), out.data()};
}

void bind_lookahead(nb::module_& m) {
  unlocked(m, "roll_out",
           [](Reals start, Reals speed, Reals first, Reals second, Reals change, Reals rate, Reals twist, Numbers done,
              Same<double> pose) {
             const Manoeuvres view{start.data(), speed.data(), first.data(), second.data(), change.data(),
                                   rate.data(),  twist.data(), done.data(),  speed.size()};
             roll_out(view, pose.shape(0), pose.shape(1), pose.data());
           });
  unlocked(m, "near_discs",
           [](Reals pose, Reals time, Reals discs, Reals size, double lookahead, double far, Same<double> out) {
             const Discs view{discs.data(), nullptr, discs.shape(0)};
             near_discs(rollout_of(pose, time, out), view, size.data(), lookahead, far);
           });
  unlocked(m, "possible_discs",
           [](Reals pose, Reals time, Reals discs, Reals error, Reals middle, Reals half, Reals low, Reals high,
              double far, Same<double> out) {
             const Discs view{discs.data(), error.data(), discs.shape(0)};
             possible_discs(rollout_of(pose, time, out), view, footprint_of(middle, half, low, high), far);
           });
  unlocked(m, "standing_boxes",
           [](Reals pose, Reals boxes, Reals middle, Reals half, Reals low, Reals high, double least, double far,
              Same<double> out) {
             const Rollout view{pose.data(), nullptr, pose.shape(0), pose.shape(1), out.data()};
             standing_boxes(view, boxes.data(), boxes.shape(0), footprint_of(middle, half, low, high), least, far);
           });
}

void bind_timing(nb::module_& m) {
  unlocked(
      m, "travel_at", [](Reals knots, Reals coefficients, Reals edges, MaybeReals weights, Reals s, Same<double> out) {
        const Travel curve{knots.data(),     coefficients.data(), edges.data(), weights ? weights->data() : nullptr,
                           knots.size() - 1, edges.size() - 1,    out.shape(2)};
        double* y = out.data();
        travel_at(curve, s.data(), s.size(), y, y + out.size() / 3, y + 2 * (out.size() / 3));
      });
  unlocked(m, "lead_base",
           [](Reals yaw, Reals twist, Reals shape, Reals rate, Reals target, double width, double lever, bool rolling,
              double largest, double near, double stalled, int iterations, Same<double> weights) {
             const Windows windows{yaw.data(),   twist.data(), shape.data(), rate.data(), target.data(),
                                   yaw.shape(0), yaw.shape(1), width,        lever,       rolling};
             lead_base(windows, largest, near, stalled, iterations, weights.data());
           });
  unlocked(m, "fastest",
           [](Reals grid, Reals y1, Reals y2, Reals bound, Reals acceleration, double start, Same<double> x) {
             const Grid view{grid.data(), y1.data(), y2.data(), acceleration.data(), grid.size(), acceleration.size()};
             return fastest(view, bound.data(), start, x.data());
           });
  unlocked(m, "braked",
           [](Reals grid, Reals y1, Reals y2, Reals acceleration, double start, double part, Same<double> x) {
             const Grid view{grid.data(), y1.data(), y2.data(), acceleration.data(), grid.size(), acceleration.size()};
             braked(view, start, part, x.data());
           });
}

}  // namespace

NB_MODULE(_native, m) {
  nb::set_leak_warnings(false);  // what Python keeps until it ends is no leak
  m.attr("coal_version") = std::to_string(COAL_MAJOR_VERSION) + "." + std::to_string(COAL_MINOR_VERSION) + "." +
                           std::to_string(COAL_PATCH_VERSION);
  bind_robot(m);
  bind_obstacles(m);
  bind_self(m);
  bind_system(m);
  bind_validity(m);
  bind_lookahead(m);
  bind_timing(m);
}
