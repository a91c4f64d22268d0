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
#include <mutex>

#include "certificate.hpp"
#include "filter.hpp"
#include "grid.hpp"
#include "holes.hpp"
#include "lookahead.hpp"
#include "path_proof.hpp"
#include "rays.hpp"
#include "search.hpp"
#include "system.hpp"
#include "timing.hpp"
#include "validity.hpp"
#include "volume.hpp"

namespace nb = nanobind;
using namespace strips;

namespace {

// An array of Python's itself, contiguous and of this very type, and never a converted copy.
template <typename T>
struct Same : nb::ndarray<T, nb::c_contig, nb::device::cpu> {
  using Array = nb::ndarray<T, nb::c_contig, nb::device::cpu>;
  using Array::Array;
  template <typename U>
  operator std::vector<U>() const {
    return std::vector<U>(this->data(), this->data() + this->size());
  }
};

}  // namespace

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

using Reals = Same<const double>;
using Numbers = Same<const std::int64_t>;
using Flags = Same<const bool>;
using MaybeReals = std::optional<Reals>;

void require(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

bool finite(const double* x, std::size_t count) {
  double nought[8] = {};  // eight sums side by side, which stay 0
  std::size_t k = 0;
  for (; k + 8 <= count; k += 8) {
    for (std::size_t i = 0; i < 8; ++i) nought[i] += x[k + i] * 0.0;
  }
  for (; k < count; ++k) nought[0] += x[k] * 0.0;
  return std::all_of(nought, nought + 8, [](double sum) { return sum == 0.0; });
}

// Sizes that arrays have in common, by letters, 'z' the stamp of the parts that they number: what does not fit is
// refused before anything is read or written.
struct Sizes {
  Sizes() { std::fill_n(size, 26, kOpen); }
  explicit Sizes(const Tree& tree) : Sizes() {
    is('j', tree.joints).is('v', tree.nv).is('r', tree.nv - tree.base_nv()).is('m', tree.motions());
  }
  explicit Sizes(const Bodies& bodies) : Sizes(bodies.tree) { is('g', bodies.size()); }
  explicit Sizes(const Narrowphase& narrow) : Sizes(*narrow.bodies) {}
  explicit Sizes(const SelfPairs& pairs) : Sizes(pairs.bodies()) { is('s', pairs.size()); }

  Sizes& is(char letter, std::size_t value) {
    std::size_t& known = size[letter - 'a'];
    require(known == kOpen || known == value,
            "what is handed over together is not of the same size, or of other parts");
    known = value;
    return *this;
  }
  Sizes& has(const Parts& parts) { return is('p', parts.count()).is('z', parts.stamp); }
  Sizes& has(const Moving& moving) { return moving.mover ? is('n', moving.nodes).is('z', moving.stamp) : *this; }
  Sizes& has(const Distances& d) { return is('n', d.nodes).is('g', d.bodies).is('p', d.parts).is('z', d.stamp); }
  Sizes& has(const SelfDistances& d) { return is('n', d.nodes).is('s', d.pairs); }
  Sizes& has(const System& system) { return is('n', system.nodes).is('v', system.nv); }

  // One word for each array, such as "nv ?j>n34 k<n": a letter is the size that it was before, 'N' one less than 'n',
  // ">n" at least that, and a digit itself; "<n" at the end are numbers of what there are n of, "~n" -1 among them.
  // What is only read has to be finite, but after a '?': there the function has an answer to what is no number. So it
  // is with placements, which `place` makes of finite coordinates: of what is nowhere nothing is proven.
  template <typename... A>
  Sizes& operator()(const char* words, const A&... arrays) {
    (fit(words, arrays), ...);
    return *this;
  }

  template <typename T>
  void fit(const char*& at, const std::optional<T>& array) {
    if (array) return fit(at, *array);
    while (*at != '\0' && *at++ != ' ') continue;
  }
  template <typename T>
  void fit(const char*& at, const Same<T>& array) {
    const char* word = at;
    const bool any = *at == '?';
    at += any;
    std::size_t k = 0;
    bool fits = true;
    for (; *at != '\0' && *at != ' ' && *at != '<' && *at != '~'; ++at, ++k) {
      const bool least = *at == '>';
      at += least;
      std::size_t digit = *at - '0', &known = *at <= '9' ? digit : size[(*at | 0x20) - 'a'];
      if (k >= array.ndim()) continue;
      const std::size_t found = array.shape(k) + (*at >= 'A' && *at <= 'Z');
      if (known == kOpen) known = found;
      fits = fits && (least ? found >= known : found == known);
    }
    fits = fits && k == array.ndim();
    if (*at == '<' || *at == '~') {
      const std::int64_t low = *at == '~' ? -1 : 0, high = size[at[1] - 'a'];
      for (std::size_t i = 0; fits && i < array.size(); ++i) {
        const auto number = static_cast<std::int64_t>(array.data()[i]);
        fits = number >= low && number < high;
      }
      at += 2;
    }
    if (!fits)
      throw std::invalid_argument("arrays do not fit each other: '" + std::string(word, at) + "' is the first");
    if constexpr (std::is_same_v<T, const double>) require(any || finite(array.data(), array.size()), kNoNumber);
    at += *at == ' ';
  }

  static constexpr std::size_t kOpen = static_cast<std::size_t>(-2);
  static constexpr char kNoNumber[] = "an array holds what is no number";
  std::size_t size[26];
};

// Rows (node, body) of a `start` (N * G + 1) that lie one behind the other in what `part` (K) numbers.
Sizes& rows(Sizes& sizes, const Numbers& start, const Numbers& part) {
  const std::size_t count = sizes.size['n' - 'a'] * sizes.size['g' - 'a'] + 1;
  sizes.is('l', count).is('k', part.size())("l", start);
  require(start.data()[0] == 0 && std::is_sorted(start.data(), start.data() + count),
          "rows that do not follow each other");
  require(start.data()[count - 1] == static_cast<std::int64_t>(part.size()), "rows of more or less than there is");
  return sizes;
}

// An array of Python's that owns what was in a vector.
nb::ndarray<nb::numpy, std::int64_t, nb::ndim<1>> given_away(std::vector<std::int64_t>& numbers) {
  auto* kept = new std::vector<std::int64_t>(std::move(numbers));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<std::int64_t>*>(p); });
  return {kept->data(), {kept->size()}, owner};
}

// A function that runs without the interpreter's lock.
template <typename Scope, typename F>
void unlocked(Scope& scope, const char* name, F&& function) {
  scope.def(name, std::forward<F>(function), nb::call_guard<nb::gil_scoped_release>());
}

// The arrays T (joints, capacity, 3, 4) and J (capacity, M, 6) of a Kinematics.
Frames frames_of(const Reals& T, const double* J = nullptr) { return {T.data(), J, T.shape(1)}; }

// A view of arrays of Python's that many calls work on; it keeps them alive.
template <typename View>
struct Kept : View {
  std::shared_ptr<void> arrays;
};
template <char... Letters, typename View, typename... A>
void keep(Kept<View>* self, Sizes sizes, const char* words, const A&... arrays) {
  sizes(words, arrays...);
  new (self)
      Kept<View>{{arrays.data()..., sizes.size[Letters - 'a']...}, std::make_shared<std::tuple<A...>>(arrays...)};
}
using MaybeMoving = std::optional<Kept<Moving>>;
Moving view(const MaybeMoving& moving) { return moving ? Moving(*moving) : Moving(); }

// Who is inside has these buffers for itself: others run meanwhile, and are turned away.
template <typename Workspace>
std::unique_lock<std::mutex> enter(Workspace& workspace) {
  std::unique_lock<std::mutex> inside(workspace.busy, std::try_to_lock);
  if (!inside) throw Failure("ThreadError", "another thread is at work in these very buffers");
  return inside;
}

using CountsOut = std::pair<std::size_t, std::size_t>;
CountsOut counted(const Counts& counts) { return {counts.pairs, counts.queries}; }

// (place, pair, distance, certain) of the worst place, or None; configurations measured between nodes; counts.
using Proof = std::tuple<std::optional<std::tuple<double, std::int64_t, double, bool>>, std::size_t, CountsOut>;
Proof proof(const Worst& worst, std::size_t checks, const Counts& counts) {
  if (!worst.there) return {std::nullopt, checks, counted(counts)};
  return {std::make_tuple(worst.place, worst.pair, worst.distance, worst.certain), checks, counted(counts)};
}

// Bisect what is open and not decided; what is left then is unknown.
Proof bisected(Bisection& bisection, Pairs& pairs, const std::vector<Interval>& todo, Search& search) {
  for (const Interval& x : todo) search.found(x.low, x.pair, std::min(x.d_low, x.d_high));
  std::vector<Interval> open;
  for (const Interval& x : todo) {
    if (!search.decided(x.low)) open.push_back(x);
  }
  search.unknown(bisection.run(pairs, std::move(open), search, nullptr));
  return proof(search.worst, bisection.checks, pairs.counts);
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
  m.def("primitive", &primitive);
  m.def("convex", [](Reals points, Same<const std::uint32_t> triangles, double swept) {
    Sizes()("n3 t3<n", points, triangles);
    require(triangles.size() > 0, "a convex shape without triangles");
    return convex(points.data(), points.shape(0), triangles.data(), triangles.shape(0), swept);
  });
  m.def("spheres", [](const Solid& solid, std::size_t most, double fine) {
    require(solid.shape != nullptr && most > 0 && most <= 256 && fine >= 0.0, "spheres for a block, none or too many");
    std::vector<std::tuple<float, float, float, float, float, std::uint32_t>> all;
    for (const SphereTree::Sphere& s : sphere_tree(*solid.shape, most, fine).spheres) {
      all.emplace_back(s.center[0], s.center[1], s.center[2], s.outer, s.inner, s.next);
    }
    return all;
  });
  m.def("block", [](Reals sides, Reals at) {
    Sizes()("n3 n3", sides, at);
    return block(sides.data(), at.data(), sides.shape(0));
  });

  nb::class_<Tree> tree_class(m, "Tree");
  tree_class.def(
      "__init__", [](Tree* self, bool planar, Numbers parents, Numbers motion, Flags prismatic, Flags circular,
                     Flags support, Reals offset, Numbers coordinate, Reals rate, Reals shift) {
        const std::size_t base = planar ? 3 : 0, nv = circular.size() + base, joints = parents.size();
        Sizes().is('v', nv)("jm j j~m j j44 r m<v m m", support, parents, motion, prismatic, offset, circular,
                            coordinate, rate, shift);
        require(joints > base / 3 && coordinate.size() >= nv, "a tree without joints or motions for its columns");
        for (std::size_t i = 1; i < joints; ++i) {
          const bool root = planar && i == 1, behind = parents.data()[i] < static_cast<std::int64_t>(i);
          require(parents.data()[i] >= 0 && behind, "a joint before its parent");
          require((motion.data()[i] < 0) == root, "a joint without a motion, or a planar root with one");
        }
        const Space space{static_cast<int>(nv), planar, circular};
        const int count = static_cast<int>(joints);
        new (self) Tree{space, count, parents, motion, coordinate, prismatic, support, offset, rate, shift};
      });
  unlocked(
      tree_class, "place", [](const Tree& tree, Reals coordinates, Same<double> T, Same<double> J, bool jacobians) {
        Sizes{tree}("nv j>n34 >nm6", coordinates, T, J);
        place(tree, coordinates.data(), coordinates.shape(0), T.data(), jacobians ? J.data() : nullptr, T.shape(1));
      });

  nb::class_<Bodies>(m, "Bodies")
      .def("__init__", [](Bodies* self, const Tree& tree, const std::vector<Solid>& solids, Numbers joint,
                          Reals rotation, Reals translation, Reals ends, Reals radius, double skin) {
        Sizes(tree).is('g', solids.size())("g<j g33 g3 g23 g", joint, rotation, translation, ends, radius);
        for (const Solid& solid : solids) require(solid.shape != nullptr, "a body that is a block");
        new (self) Bodies{tree, solids, joint, rotation, translation, ends, radius, skin};
      });
}

void bind_distances(nb::module_& m) {
  nb::class_<Kept<Parts>>(m, "Parts")
      .def("__init__",
           [](Kept<Parts>* self, const std::vector<std::optional<Solid>>& solids, Reals rotation, Reals translation,
              Reals center, Reals half) {
             keep(self, Sizes().is('p', solids.size()), "p33 p3 p3 p3", rotation, translation, center, half);
             for (const auto& solid : solids) self->solids.push_back(solid.value_or(Solid()));
           })
      .def("keep", [](Kept<Parts>& self, const Kept<Parts>& former, Numbers source) {
        Sizes().is('p', self.count()).is('q', former.count())("p~q", source);
        for (std::size_t p = 0; p < self.count(); ++p) {
          const std::int64_t was = source.data()[p];
          if (was >= 0 && !self.solids[p].key()) self.solids[p] = former.solids[static_cast<std::size_t>(was)];
        }
      });
  nb::class_<Kept<Moving>>(m, "Moving")
      .def("__init__", [](Kept<Moving>* self, const Kept<Parts>& parts, Reals shift, Reals uncertainty, Numbers mover) {
        require(shift.ndim() > 0 && shift.shape(0) > 0, "a forecast for no node");
        keep<'n', 'm', 'p'>(self, Sizes().has(parts), "nm3 nm p~m", shift, uncertainty, mover);
        self->stamp = parts.stamp;
      });
  nb::class_<Kept<Distances>>(m, "Distances")
      .def("__init__", [](Kept<Distances>* self, const Kept<Parts>& parts, Same<double> bound, Same<double> since,
                          Same<double> exact, Same<double> direction, Same<double> witness, Reals limit, Numbers start,
                          Numbers part, Same<double> floor) {
        require(floor.ndim() == 2, "no floor for each body of each node");
        Sizes sizes = Sizes().has(parts);
        rows(sizes.is('n', floor.shape(0)).is('g', floor.shape(1)), start, part);
        keep<'k', 'n', 'g', 'p'>(self, sizes, "k k k k3 k3 p l k<p ng", bound, since, exact, direction, witness, limit,
                                 start, part, floor);
        self->stamp = parts.stamp;
      });
  m.def("near_parts", [](Reals center, Reals radius, Reals low, Reals high, Flags always, Flags fresh, Numbers start,
                         Numbers part, Numbers source, std::size_t former) {
    Sizes sizes;
    sizes("?ng3 ?ng p3 p3 p n", center, radius, low, high, always, fresh);
    rows(sizes.is('q', former), start, part)("l k<q p~q", start, part, source);
    const Balls balls{center.data(),   radius.data(),   low.data(),  high.data(),
                      radius.shape(0), radius.shape(1), low.shape(0)};
    auto near = std::make_unique<Near>();
    {
      nb::gil_scoped_release free;
      *near = near_parts(balls, always.data(), fresh.data(), start.data(), part.data(), source.data());
    }
    return nb::make_tuple(given_away(near->start), given_away(near->part), given_away(near->from));
  });

  nb::class_<Narrowphase> narrowphase(m, "Narrowphase");
  narrowphase.def(nb::init<std::shared_ptr<Bodies>>());
  unlocked(narrowphase, "query",
           [](Narrowphase& self, Reals T, Numbers node, Numbers body, Numbers part, const Kept<Parts>& parts,
              MaybeReals shift, Same<double> distance, Same<double> direction, Same<double> witness) {
             const auto inside = enter(self);
             Sizes(self).has(parts)("?jc34 k<c k<g k<p k3 k k3 k3", T, node, body, part, shift, distance, direction,
                                    witness);
             Queries ask(self, frames_of(T), parts);
             for (std::size_t k = 0; k < node.size(); ++k) {
               Vec3 by;
               if (shift) by = Eigen::Map<const Vec3>(shift->data() + 3 * k);
               const Found found = ask.exact(node.data()[k], body.data()[k], part.data()[k], shift ? &by : nullptr);
               distance.data()[k] = found.distance;
               Eigen::Map<Vec3>(direction.data() + 3 * k) = found.direction;
               Eigen::Map<Vec3>(witness.data() + 3 * k) = found.witness;
             }
           });
  unlocked(narrowphase, "refine",
           [](Narrowphase& self, Reals T, const Kept<Parts>& parts, const MaybeMoving& moving, double influence,
              Kept<Distances>& distances) {
             const auto inside = enter(self);
             Sizes(self).has(parts).has(distances).has(view(moving))("?j>n34", T);
             Queries ask(self, frames_of(T), parts, view(moving));
             refine(ask, influence, distances);
             return counted(ask.counts);
           });
  unlocked(narrowphase, "follow",
           [](const Narrowphase& self, Reals T, Reals coordinates, double influence, Same<double> kept,
              Same<double> ends, Same<double> rotations, Reals low, Reals high, Same<std::int64_t> cover,
              Same<double> margin, Kept<Distances>& distances) {
             Sizes(self).has(distances)("?j>n34 nv nv ng23 ng33 c3 c3 n~c n", T, coordinates, kept, ends, rotations,
                                        low, high, cover, margin);
             Nodes nodes{kept.data(), ends.data(),  rotations.data(), low.data(),
                         high.data(), cover.data(), margin.data()};
             return follow(*self.bodies, frames_of(T), coordinates.data(), influence, nodes, distances);
           });
  unlocked(narrowphase, "certify",
           [](Narrowphase& self, Reals T, Reals J, Reals coordinates, Reals v, const Kept<Parts>& parts,
              const MaybeMoving& moving, Reals radius, MaybeReals approach, Kept<Distances>& distances,
              double clearance, int depth, Same<std::int8_t> states) {
             const auto inside = enter(self);
             Sizes(self).has(parts).has(distances).has(view(moving))("?j>n34 ?>nm6 nv Nv mg Np N", T, J, coordinates, v,
                                                                     radius, approach, states);
             require(distances.nodes > 1, "a strip of less than two nodes");
             Search search{clearance, states.data()};
             Queries ask(self, frames_of(T, J.data()), parts, view(moving));
             Bisection bisection(self.bodies->tree, ask.frames, coordinates.data(), v.data(), depth);
             colliding_nodes(ask, distances, search);
             const double* nearer = approach ? approach->data() : nullptr;
             const std::vector<Interval> todo = open_obstacles(ask, radius.data(), v.data(), nearer, search, distances);
             ObstaclePairs pairs(self, parts, ask.moving);
             pairs.counts = ask.counts;
             return bisected(bisection, pairs, todo, search);
           });
  unlocked(
      narrowphase, "prove",
      [](Narrowphase& self, Reals T, Reals coordinates, Reals v, const Kept<Parts>& parts, const MaybeMoving& moving,
         Reals travel, MaybeReals approach, double clearance, int depth) {
        const auto inside = enter(self);
        const Moving moves = view(moving);
        Sizes{self}("nv Nv ?j>n34 Ng Np", coordinates, v, T, travel, approach).has(parts).has(moves);
        const std::size_t bodies = self.bodies->size(), count = parts.count();
        const std::vector<double> own = summed(travel), theirs = approach ? summed(*approach) : std::vector<double>();
        const Approach nearer = [&](std::int64_t pair, std::size_t low, std::size_t high) {
          const std::size_t g = static_cast<std::size_t>(pair) / count, p = static_cast<std::size_t>(pair) - g * count;
          const double sum = own[high * bodies + g] - own[low * bodies + g];
          return theirs.empty() ? sum : sum + (theirs[high * count + p] - theirs[low * count + p]);
        };
        ObstaclePairs pairs(self, parts, moves);
        Bisection bisection(self.bodies->tree, frames_of(T), coordinates.data(), v.data(), depth);
        const Worst worst = prove_motion(pairs, bodies * count, bisection, coordinates.shape(0), clearance, nearer);
        return proof(worst, bisection.checks, pairs.counts);
      });

  nb::class_<Kept<SelfDistances>>(m, "SelfDistances")
      .def("__init__", [](Kept<SelfDistances>* self, Same<double> bound, Same<double> since, Same<double> exact,
                          Same<double> direction, Same<double> first, Same<double> second, double tolerance) {
        keep<'n', 's'>(self, Sizes(), "ns ns ns ns3 ns3 ns3", bound, since, exact, direction, first, second);
        self->tolerance = tolerance;
      });
  nb::class_<SelfPairs> selfPairs(m, "SelfPairs");
  selfPairs.def("__init__", [](SelfPairs* self, std::shared_ptr<Bodies> bodies, Numbers pairs) {
    Sizes{*bodies}("s2<g", pairs);
    new (self) SelfPairs(bodies, pairs);
  });
  unlocked(selfPairs, "update",
           [](SelfPairs& self, Reals T, Reals coordinates, Reals before, Reals radius, Reals reach,
              Kept<SelfDistances>& distances) {
             const auto inside = enter(self);
             Sizes(self).has(distances)("?j>n34 nv ?nv vs s", T, coordinates, before, radius, reach);
             self.counts = {};
             PairRadii radii(self.bodies().tree, radius.data(), self.size());
             self_drift(coordinates.data(), before.data(), coordinates.shape(1), radii, distances);
             self_refine(self, frames_of(T), coordinates.data(), radii, reach.data(), distances);
             return counted(self.counts);
           });
  unlocked(selfPairs, "certify",
           [](SelfPairs& self, Reals T, Reals coordinates, Reals v, Reals radius, Kept<SelfDistances>& distances,
              double clearance, int depth, Same<std::int8_t> states) {
             const auto inside = enter(self);
             Sizes(self).has(distances)("?j>n34 nv Nv vs N", T, coordinates, v, radius, states);
             const Frames frames = frames_of(T);
             Search search{clearance, states.data()};
             self.counts = {};
             const Tree& tree = self.bodies().tree;
             Bisection bisection(tree, frames, coordinates.data(), v.data(), depth);
             PairRadii radii(tree, radius.data(), self.size());
             const std::vector<Interval> todo = open_self(self, frames, v.shape(1), radii, v.data(), search, distances);
             return bisected(bisection, self, todo, search);
           });
  unlocked(selfPairs, "prove",
           [](SelfPairs& self, Reals T, Reals coordinates, Reals v, Reals travel, double clearance, int depth) {
             const auto inside = enter(self);
             Sizes{self}("nv Nv Ns ?j>n34", coordinates, v, travel, T);
             const std::size_t count = self.size();
             const std::vector<double> own = summed(travel);
             const Approach nearer = [&](std::int64_t pair, std::size_t low, std::size_t high) {
               return own[high * count + pair] - own[low * count + pair];
             };
             self.counts = {};
             Bisection bisection(self.bodies().tree, frames_of(T), coordinates.data(), v.data(), depth);
             const Worst worst = prove_motion(self, count, bisection, coordinates.shape(0), clearance, nearer);
             return proof(worst, bisection.checks, self.counts);
           });
}

// Parts with all their solids, for those who take them as they are.
const Kept<Parts>& made(const Kept<Parts>& parts) {
  for (std::size_t p = 0; p < parts.count(); ++p) parts.solid(p);
  return parts;
}

// A Validity and the arrays that it reads.
struct Checker {
  const Kept<Parts> parts;
  const Reals radius;
  Validity validity;

  Checker(std::shared_ptr<Bodies> bodies, const Kept<Parts>& among, Numbers self_pairs, Reals radii, double margin,
          double self_margin)
      : parts(made(among)), radius(radii), validity(bodies, parts, self_pairs, radius.data(), margin, self_margin) {}

  const double* row(const Reals& coordinates) const {
    Sizes{validity.tree()}("v", coordinates);
    return coordinates.data();
  }
};

// States of a planner: the last coordinates, each in units of its own.
struct Chart {
  Checker* checker;
  std::vector<double> one, two, per_unit;

  bool motion(const std::vector<double>& a, const std::vector<double>& b, double step) {
    return checker->validity.motion(filled(one, a), filled(two, b), step);
  }
  const double* filled(std::vector<double>& row, const std::vector<double>& state) const {
    require(state.size() == per_unit.size(), "a state of another size than the chart");
    const std::size_t first = row.size() - per_unit.size();
    for (std::size_t k = 0; k < per_unit.size(); ++k) row[first + k] = state[k] * per_unit[k];
    require(finite(row.data(), row.size()), Sizes::kNoNumber);
    return row.data();
  }
};

// A PathProof and the arrays that it reads.
struct Prover {
  const Kept<Parts> parts;
  const Reals radius, self_radius;
  PathProof proof;

  Prover(std::shared_ptr<Bodies> bodies, const Kept<Parts>& among, Numbers self_pairs, Reals radii, Reals self_radii)
      : parts(made(among)),
        radius(radii),
        self_radius(self_radii),
        proof(bodies, parts, self_pairs, radius.data(), self_radius.data()) {}
};

struct Filter {
  std::shared_ptr<Bodies> bodies;
  SphereFilter filter;

  Filter(std::shared_ptr<Bodies> of, const Kept<Parts>& parts, const std::vector<std::int64_t>& self_pairs,
         double margin, double self_margin)
      : bodies(of), filter(*of, made(parts), self_pairs, margin, self_margin) {}
};

void bind_validity(nb::module_& m) {
  nb::class_<Checker> validity(m, "Validity");
  validity.def("__init__", [](Checker* self, std::shared_ptr<Bodies> bodies, const Kept<Parts>& parts,
                              Numbers self_pairs, Reals radius, double margin, double self_margin) {
    Sizes(*bodies).has(parts)("mg s2<g", radius, self_pairs);
    new (self) Checker(bodies, parts, self_pairs, radius, margin, self_margin);
  });
  validity.def("valid", [](Checker& self, Reals row) { return self.validity.valid(self.row(row)); });
  validity.def("each", [](Checker& self, Reals rows, bool base, Same<std::int8_t> states) {
    Sizes(self.validity.tree())("nv n", rows, states);
    self.validity.each(rows.data(), states.size(), base, states.data());
  });
  validity.def("motion", [](Checker& self, Reals a, Reals b, double step) {
    return self.validity.motion(self.row(a), self.row(b), step);
  });
  validity.def(
      "chart",
      [](Checker& self, Reals row, Reals unit) {
        self.row(row);
        Sizes()("k", unit);
        require(unit.size() <= row.size(), "a chart of more coordinates than there are");
        return Chart{&self, row, row, unit};
      },
      nb::keep_alive<0, 1>());
  nb::class_<Prover> prover(m, "PathProof");
  prover.def("__init__", [](Prover* self, std::shared_ptr<Bodies> bodies, const Kept<Parts>& parts, Numbers self_pairs,
                            Reals radius, Reals self_radius) {
    Sizes(*bodies).has(parts)("mg s2<g vs", radius, self_pairs, self_radius);
    new (self) Prover(bodies, parts, self_pairs, radius, self_radius);
  });
  unlocked(prover, "prove",
           [](Prover& self, Reals rows, Reals v, double clearance, double self_clearance, int depth, bool all,
              Same<std::int8_t> states) {
             Sizes(self.proof.tree())("nv Nv N", rows, v, states);
             require(rows.shape(0) > 1, "a path without a segment");
             const std::size_t checks = self.proof.checks, queries = self.proof.queries;
             require(clearance >= 0.0 && self_clearance >= 0.0, "a clearance below nothing");
             self.proof.prove(rows.data(), v.data(), rows.shape(0), clearance, self_clearance, std::min(depth, 64), all,
                              states.data());
             return std::make_pair(self.proof.checks - checks, self.proof.queries - queries);
           });
  unlocked(prover, "least", [](Prover& self, Reals rows, Reals v, double tolerance, double most) {
    Sizes(self.proof.tree())("nv Nv", rows, v);
    require(rows.shape(0) > 1, "a path without a segment");
    require(tolerance > 0.0 && most <= FAR, "a tolerance of nothing, or no end");
    const std::size_t checks = self.proof.checks, queries = self.proof.queries;
    const double least = self.proof.least(rows.data(), v.data(), rows.shape(0), tolerance, most);
    return std::make_tuple(least, self.proof.checks - checks, self.proof.queries - queries);
  });
  m.attr("instructions") = SphereFilter::instructions();
  nb::class_<Filter> filter(m, "SphereFilter");
  filter.def("__init__", [](Filter* self, std::shared_ptr<Bodies> bodies, const Kept<Parts>& parts, Numbers self_pairs,
                            double margin, double self_margin) {
    Sizes(*bodies).has(parts)("s2<g", self_pairs);
    new (self) Filter(bodies, parts, self_pairs, margin, self_margin);
  });
  unlocked(filter, "look", [](Filter& self, Reals rows, Same<std::int8_t> verdict) {
    Sizes(self.bodies->tree)("nv n", rows, verdict);
    const std::size_t nv = rows.shape(1), n = rows.shape(0);
    std::size_t pairs = 0;
    for (std::size_t k = 0; k < n; k += kRows) {
      const std::size_t count = std::min<std::size_t>(kRows, n - k);
      const unsigned hit = self.filter.look(rows.data() + k * nv, count, false);
      pairs += self.filter.open().size();
      for (std::size_t i = 0; i < count; ++i) verdict.data()[k + i] = hit >> i & 1;
      for (const SphereOpen& o : self.filter.open()) verdict.data()[k + o.row] = 2;
    }
    return pairs;
  });
  nb::class_<Chart>(m, "Chart").def("motion", &Chart::motion);
  unlocked(validity, "search",
           [](Checker& self, Reals ends, Reals scale, Reals low, Reals high, Reals period, std::uint64_t seed,
              double step, double range, std::size_t checks, double seconds, int tries) {
             Sizes(self.validity.tree())("2v k k k k", ends, scale, low, high, period);
             const std::size_t nv = ends.shape(1), first = nv - scale.size();
             require(scale.size() > 0 && scale.size() <= nv, "a search among no coordinates, or more than there are");
             require(step > 0.0 && range >= 1e-6, "a search without a step or a range");
             require(seconds == seconds && tries >= 0,
                     "a search until a time that is no number, or of less than no tries");
             for (std::size_t k = 0; k < scale.size(); ++k) {
               const double most = std::max(std::abs(ends.data()[first + k]), std::abs(ends.data()[nv + first + k]));
               const double far = std::max(std::abs(low.data()[k]), std::abs(high.data()[k]));
               require(scale.data()[k] > 0.0 && std::max(far, most * scale.data()[k]) <= 1e6 && period.data()[k] >= 0.0,
                       "a search among coordinates without a scale, or too far away");
             }
             const SearchSpace space{nv, first, scale, low, high, period};
             return found_path(self.validity, space, {step, range, checks, seconds}, seed, ends.data(),
                               ends.data() + nv, tries);
           });
  validity.def_prop_ro("checks", [](const Checker& self) { return self.validity.checks; });
}

// The space of rows (K, nv) of three arrays.
Space space_of(bool planar, const Flags& circular, const Reals& a, const Reals& b, const Same<double>& c) {
  const std::size_t nv = circular.size() + (planar ? 3 : 0);
  Sizes().is('v', nv)("r ?kv ?kv kv", circular, a, b, c);
  return {static_cast<int>(nv), planar, circular};
}

void bind_system(nb::module_& m) {
  nb::class_<Kept<System>> system(m, "System");
  system.def("__init__", [](Kept<System>* self, Same<double> force, Same<double> diagonal, Same<double> upper) {
    keep<'n', 'v'>(self, Sizes(), force.size() > 0 ? "nv nvv Nvv" : "nv nvv nvv", force, diagonal, upper);
  });
  unlocked(system, "add_elastic", [](Kept<System>& self, bool planar, Reals v, Reals weight) {
    require(self.nodes > 0 && (!planar || self.nv >= 3), "springs between no nodes, or of a base without columns");
    Sizes().has(self)("Nv v", v, weight);
    return add_elastic(self, planar, v.data(), weight.data());
  });
  unlocked(system, "add_repulsion",
           [](Kept<System>& self, const Narrowphase& narrow, Reals J, const Kept<Distances>& distances,
              double influence, double k_r, double near, double k_near) {
             Sizes(narrow).has(self).has(distances)("?>nm6", J);
             return add_repulsion(self, *narrow.bodies, J.data(), distances, influence, k_r, near, k_near);
           });
  unlocked(system, "add_self_repulsion",
           [](Kept<System>& self, const SelfPairs& pairs, Reals T, Reals J, const Kept<SelfDistances>& distances,
              Reals repulsion, double k_s) {
             Sizes(pairs).has(self).has(distances)("?j>n34 ?>nm6 s", T, J, repulsion);
             return add_self_repulsion(self, pairs, frames_of(T, J.data()), distances, repulsion.data(), k_s);
           });
  unlocked(system, "add_posture", [](Kept<System>& self, Reals coordinates, Reals target, Reals k_p, Flags circular) {
    Sizes().has(self)("nv nv v r", coordinates, target, k_p, circular);
    require(circular.size() <= k_p.size(), "more joints than columns");
    const auto* turning = reinterpret_cast<const std::uint8_t*>(circular.data());
    return add_posture(self, coordinates.data(), target.data(), k_p.data(), turning, self.nv - circular.size());
  });
  unlocked(system, "solve", [](const Kept<System>& self, Reals damping, Same<double> delta) {
    Sizes().has(self)("v nv", damping, delta);
    solve(self, damping.data(), delta.data());
  });
  unlocked(m, "difference", [](bool planar, Flags circular, Reals a, Reals b, Same<double> v) {
    const Space space = space_of(planar, circular, a, b, v);
    for (std::size_t k = 0; k < v.size(); k += space.nv) difference(space, a.data() + k, b.data() + k, v.data() + k);
  });
  unlocked(m, "integrate", [](bool planar, Flags circular, Reals a, Reals v, Same<double> out) {
    const Space space = space_of(planar, circular, a, v, out);
    for (std::size_t k = 0; k < v.size(); k += space.nv) {
      integrate(space, a.data() + k, v.data() + k, 1.0, out.data() + k);
    }
  });
  unlocked(m, "project_rolling", [](Same<double> coordinates, int iterations) {
    Sizes().is('v', 3)("n>v", coordinates);
    require(coordinates.shape(0) > 0, "rolling of no node");
    int taken = 0;
    const double residual = project_rolling(coordinates.data(), coordinates.shape(0),
                                            static_cast<int>(coordinates.shape(1)), iterations, taken);
    return std::make_pair(residual, taken);
  });
}

// The robot's boxes, as PlanarFootprint has them, and a view of roll-outs.
Footprint footprint_of(const Reals& middle, const Reals& half, const Reals& low, const Reals& high) {
  Sizes()("b2 b2 b b", middle, half, low, high);
  return {middle.data(), half.data(), low.data(), high.data(), low.size()};
}
Rollout rollout_of(const Reals& pose, const MaybeReals& time, Same<double>& out) {
  Sizes()("nt3 t nt", pose, time, out);
  return {pose.data(), time ? time->data() : nullptr, pose.shape(0), pose.shape(1), out.data()};
}

Grid grid_of(const Reals& grid, const Reals& y1, const Reals& y2, const Reals& acceleration, const Same<double>& x) {
  Sizes()("g ?gm ?gm m g", grid, y1, y2, acceleration, x);
  require(grid.size() > 0 && acceleration.size() > 0, "a path without points or coordinates");
  return {grid.data(), y1.data(), y2.data(), acceleration.data(), grid.size(), acceleration.size()};
}

void bind_driving(nb::module_& m) {
  unlocked(m, "roll_out",
           [](Reals start, Reals speed, Reals first, Reals second, Reals change, Reals rate, Reals twist, Numbers done,
              Same<double> pose) {
             Sizes()("3 k nk nk k nk k3 n nt3", start, speed, first, second, change, rate, twist, done, pose);
             require(speed.size() <= 3, "a base of more than three speeds");
             const Manoeuvres view{start.data(), speed.data(), first.data(), second.data(), change.data(),
                                   rate.data(),  twist.data(), done.data(),  speed.size()};
             roll_out(view, pose.shape(0), pose.shape(1), pose.data());
           });
  unlocked(m, "near_discs",
           [](Reals pose, Reals time, Reals discs, Reals size, double lookahead, double far, Same<double> out) {
             Sizes()("d8 d", discs, size);
             const Discs view{discs.data(), nullptr, discs.shape(0)};
             near_discs(rollout_of(pose, time, out), view, size.data(), lookahead, far);
           });
  unlocked(m, "possible_discs",
           [](Reals pose, Reals time, Reals discs, Reals error, Reals middle, Reals half, Reals low, Reals high,
              double far, Same<double> out) {
             Sizes()("d8 3d", discs, error);
             const Discs view{discs.data(), error.data(), discs.shape(0)};
             possible_discs(rollout_of(pose, time, out), view, footprint_of(middle, half, low, high), far);
           });
  unlocked(m, "standing_boxes",
           [](Reals pose, Reals boxes, Reals middle, Reals half, Reals low, Reals high, double least, double far,
              Same<double> out) {
             Sizes()("k7", boxes);
             for (std::size_t k = 0; k < half.size(); ++k) {
               require(half.data()[k] >= 0.0 && half.data()[k] < 1e3 * least, "a box of no size, or of too many discs");
             }
             const Rollout view = rollout_of(pose, std::nullopt, out);
             standing_boxes(view, boxes.data(), boxes.shape(0), footprint_of(middle, half, low, high), least, far);
           });
  unlocked(
      m, "travel_at", [](Reals knots, Reals coefficients, Reals edges, MaybeReals weights, Reals s, Same<double> out) {
        Sizes()("k 4Km w W3m g 3gm", knots, coefficients, edges, weights, s, out);
        require(knots.size() > 1 && edges.size() > 1, "a curve without a piece");
        const Travel curve{knots.data(),     coefficients.data(), edges.data(), weights ? weights->data() : nullptr,
                           knots.size() - 1, edges.size() - 1,    out.shape(2)};
        double* y = out.data();
        travel_at(curve, s.data(), s.size(), y, y + out.size() / 3, y + 2 * (out.size() / 3));
      });
  unlocked(m, "lead_base",
           [](Reals yaw, Reals twist, Reals shape, Reals rate, Reals target, double width, double lever, bool rolling,
              double largest, double near, double stalled, int iterations, Same<double> weights) {
             Sizes()("wq wq3 q3 q3 w2 w33", yaw, twist, shape, rate, target, weights);
             const Windows windows{yaw.data(),   twist.data(), shape.data(), rate.data(), target.data(),
                                   yaw.shape(0), yaw.shape(1), width,        lever,       rolling};
             lead_base(windows, largest, near, stalled, iterations, weights.data());
           });
  unlocked(m, "fastest",
           [](Reals grid, Reals y1, Reals y2, Reals bound, Reals acceleration, double start, Same<double> x) {
             const Grid view = grid_of(grid, y1, y2, acceleration, x);
             Sizes().is('g', grid.size())("?g", bound);
             return fastest(view, bound.data(), start, x.data());
           });
  unlocked(m, "braked",
           [](Reals grid, Reals y1, Reals y2, Reals acceleration, double start, double part, Same<double> x) {
             braked(grid_of(grid, y1, y2, acceleration, x), start, part, x.data());
           });
}

void bind_grid(nb::module_& m) {
  unlocked(
      m, "fill_outlines",
      [](Same<std::int64_t> owner, Reals low, double resolution, Numbers whose, Reals reach, Reals at, Reals around) {
        Sizes()("rc 2 k kd k2 d2", owner, low, whose, reach, at, around);
        const std::size_t directions = around.shape(0);
        require(resolution > 0.0 && directions > 0 && directions % 4 == 0, "cells or outlines of no size");
        const Outlines outlines{whose.data(), reach.data(), at.data(), around.data(), whose.size(), directions};
        fill_outlines(outlines, {owner.shape(0), owner.shape(1), low.data(), resolution}, owner.data());
      });
  unlocked(m, "clearance_map", [](Flags taken, double resolution, Same<double> clear) {
    Sizes()("rc rc", taken, clear);
    require(resolution > 0.0, "cells of no size");
    clearance_map(taken.data(), taken.shape(0), taken.shape(1), resolution, clear.data());
  });
  unlocked(m, "cell_cost", [](Reals clear, double inner, double comfort, double narrow, Same<double> cost) {
    Sizes()("?rc rc", clear, cost);
    require(inner == inner && comfort > 0.0 && narrow >= 1.0, "costs by clearances that are none");
    cell_cost(clear.data(), clear.size(), inner, comfort, narrow, cost.data());
  });
  unlocked(m, "cheapest_route", [](Reals cost, std::size_t first, std::size_t last) {
    Sizes()("?rc", cost);
    require(first < cost.size() && last < cost.size(), "a route from or to no cell");
    require(cost.size() < std::size_t{1} << 31, "too many cells");
    return cheapest_route(cost.data(), cost.shape(0), cost.shape(1), first, last);
  });
}

void bind_rays(nb::module_& m) {
  nb::class_<RayBodies> bodies(m, "RayBodies");
  bodies.def("__init__", [](RayBodies* self, Numbers kind, Reals size, Numbers start, Reals planes) {
    Sizes()
        .is('p', kind.size())
        .is('s', kind.size() + 1)
        .is('k', RayBodies::KINDS)("p<k p3 s q4", kind, size, start, planes);
    const std::int64_t* from = start.data();
    require(from[0] == 0 && std::is_sorted(from, from + start.size()), "planes that do not follow each other");
    require(from[kind.size()] == static_cast<std::int64_t>(planes.shape(0)), "planes of more or less than there is");
    new (self) RayBodies(kind.data(), size.data(), from, planes.data(), kind.size());
  });
  unlocked(bodies, "place", [](RayBodies& self, Reals rotation, Reals translation) {
    Sizes().is('p', self.size())("p33 p3", rotation, translation);
    self.place(rotation.data(), translation.data());
  });
  unlocked(bodies, "cast",
           [](const RayBodies& self, Reals origin, Reals direction, double reach, double inside, Same<double> distance,
              std::optional<Same<double>> normal) {
             Sizes()("o3 r3 r r3", origin, direction, distance, normal);
             require(origin.shape(0) == 1 || origin.shape(0) == direction.shape(0), "origins of other rays");
             self.cast(origin.data(), origin.shape(0) == 1, direction.data(), direction.shape(0), reach, inside,
                       distance.data(), normal ? normal->data() : nullptr);
           });
}

void bind_volume(nb::module_& m) {
  using Known = Same<std::int8_t>;
  nb::class_<VolumeMap> map(m, "VolumeMap");
  map.def("__init__", [](VolumeMap* self, Numbers blocks, Numbers corner, double cell, int miss, int floor, int top,
                         int filled, int emptied) {
    Sizes()("3 3", blocks, corner);
    const std::int64_t* n = blocks.data();
    require(std::all_of(n, n + 3, [](std::int64_t each) { return each > 0 && each < 4096; }) && cell > 0.0 &&
                n[0] * n[1] * n[2] < std::int64_t{1} << 24,
            "a map of no voxels, or of too many");
    require(miss > 0 && miss <= 127 && VolumeMap::PASSED < floor && floor < emptied && emptied < filled &&
                filled < top && top < 128,
            "evidence that is out of order");
    new (self) VolumeMap(n, corner.data(), cell, {miss, floor, top, filled, emptied});
  });
  m.def("fill_holes", [](Same<const float> ranges, double unit, int widest, Same<float> out) {
    Sizes()("rc rc", ranges, out);
    require(widest > 0, "no holes to look into");
    fill_holes(ranges.data(), ranges.shape(0), ranges.shape(1), unit, widest, out.data());
  });
  m.def("count_cells", [](Numbers low, Numbers high) {
    Sizes()("n3 n3", low, high);
    for (std::size_t i = 0; i < low.size(); ++i) require(low.data()[i] < high.data()[i], "a box without a cell");
    return grid_boxes(low.data(), high.data(), low.shape(0), 1.0, nullptr, nullptr, nullptr, nullptr);
  });
  m.def("grid_boxes", [](Numbers low, Numbers high, double cell, Same<double> cells, Same<double> middles,
                         Same<double> edges, Same<double> whole) {
    Sizes()("n3 n3 c3 n3 n3 7", low, high, cells, middles, edges, whole);
    const std::size_t n = grid_boxes(low.data(), high.data(), low.shape(0), cell, nullptr, nullptr, nullptr, nullptr);
    require(n == cells.shape(0) && n > 0, "as many cells as there are in the boxes");
    grid_boxes(low.data(), high.data(), low.shape(0), cell, cells.data(), middles.data(), edges.data(), whole.data());
  });
  map.def("roll", [](VolumeMap& self, Numbers corner) {
    Sizes()("3", corner);
    self.roll(corner.data());
  });
  unlocked(map, "hit", [](VolumeMap& self, Reals points, Same<const std::int8_t> weight, Known before) {
    Sizes()("n3 n n", points, weight, before);
    self.hit(points.data(), weight.data(), weight.size(), before.data());
  });
  unlocked(map, "carve",
           [](VolumeMap& self, Same<const float> clear, bool camera, bool round, Reals scale, Reals middle,
              Reals rotation, Reals origin, double nearest, double sure, double exact) {
             Sizes()("rc 2 2 33 3", clear, scale, middle, rotation, origin);
             require(clear.size() > 0 && scale.data()[0] != 0.0 && scale.data()[1] != 0.0, "an image of no pixels");
             const Optics optics{clear.shape(0),
                                 clear.shape(1),
                                 camera,
                                 round,
                                 {scale.data()[0], scale.data()[1]},
                                 {middle.data()[0], middle.data()[1]}};
             self.carve({optics, clear.data(), rotation.data(), origin.data(), nearest, sure, exact});
           });
  unlocked(map, "look", [](const VolumeMap& self, Reals points, Known known) {
    Sizes()("n3 n", points, known);
    self.look(points.data(), known.size(), known.data());
  });
  unlocked(map, "grant", [](VolumeMap& self, Reals points) {
    Sizes()("n3", points);
    self.grant(points.data(), points.shape(0));
  });
  unlocked(map, "forget", [](VolumeMap& self, Reals points) {
    Sizes()("n3", points);
    self.forget(points.data(), points.shape(0));
  });
  map.def("changed", [](VolumeMap& self, bool doubtful) {
    std::vector<std::int64_t> blocks = self.changed(doubtful);
    return given_away(blocks);
  });
  map.def("boxes", [](const VolumeMap& self, Numbers block, bool doubtful) {
    Sizes()("3", block);
    std::vector<std::int64_t> boxes = self.boxes(block.data(), doubtful);
    return given_away(boxes);
  });
  map.def("finer_boxes", [](const VolumeMap& self, Numbers block, bool doubtful, const VolumeMap& fine) {
    Sizes()("3", block);
    std::vector<std::int64_t> boxes = self.boxes(block.data(), doubtful, fine);
    return given_away(boxes);
  });
  map.def("count", &VolumeMap::count);
}

void translate(const std::exception_ptr& thrown, void* errors) {
  try {
    std::rethrow_exception(thrown);
  } catch (const Failure& failure) {
    PyErr_SetString(nb::handle(static_cast<PyObject*>(errors)).attr(failure.name).ptr(), failure.what());
  }
}

}  // namespace

NB_MODULE(_native, m) {
  nb::register_exception_translator(translate, nb::module_::import_("elastic_strips.errors").release().ptr());
  nb::set_leak_warnings(false);  // what Python keeps until it ends is no leak
  m.attr("coal_version") = std::to_string(COAL_MAJOR_VERSION) + "." + std::to_string(COAL_MINOR_VERSION) + "." +
                           std::to_string(COAL_PATCH_VERSION);
  m.attr("interface") = STRIPS_INTERFACE;
  nb::dict constants;
#define STRIPS_EXPORT(name, value) constants[#name] = name;
  STRIPS_CONSTANTS(STRIPS_EXPORT)
  constants["COARSE_EPA_TOLERANCES"] = nb::make_tuple(COARSE_EPA_TOLERANCES[0], COARSE_EPA_TOLERANCES[1],
                                                      COARSE_EPA_TOLERANCES[2], COARSE_EPA_TOLERANCES[3]);
  nb::list moves;
  for (const auto& move : GRID_MOVES) moves.append(nb::make_tuple(move[0], move[1]));
  constants["GRID_MOVES"] = nb::tuple(moves);
  m.attr("constants") = constants;
  bind_robot(m);
  bind_distances(m);
  bind_system(m);
  bind_validity(m);
  bind_driving(m);
  bind_grid(m);
  bind_rays(m);
  bind_volume(m);
}
