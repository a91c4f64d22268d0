#include "filter.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <new>
#include <numeric>

namespace strips {

namespace {

constexpr float kLeastPad = 1e-4f;     // [m] by which distances in single precision are taken less
constexpr float kPadPerMetre = 2e-6f;  // and more the farther things are from the origin: 32 roundings
constexpr std::uint32_t kGrouped = 4;  // obstacles in a leaf of their tree
constexpr std::size_t kLevels = 6;     // of pending lists: one more than trees of spheres are deep
constexpr double kTurn = 6.28318530717958647692;
constexpr double kUpright = 1e-12;  // of a rotation by right angles, what its entries are off 0 and 1
constexpr std::align_val_t kAlignment{64};

struct Instructions {
  const char* name;
  SphereLook look;
};

Instructions best() {
#ifdef STRIPS_X86
  const char* asked = std::getenv("ELASTIC_STRIPS_INSTRUCTIONS");
  const auto may = [asked](const char* name) { return asked == nullptr || std::strcmp(asked, name) == 0; };
  if (may("avx512") && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512dq")) {
    return {"avx512", look_avx512};
  }
  if (may("avx2") && __builtin_cpu_supports("avx2")) return {"avx2", look_avx2};
#endif
  return {"baseline", look_baseline};
}

const Instructions kInstructions = best();

}  // namespace

Aligned::Aligned(std::size_t count)
    : data_(static_cast<float*>(::operator new(std::max<std::size_t>(count, 1) * sizeof(float), kAlignment))) {
  std::fill_n(data_, count, 0.0f);
}
Aligned::~Aligned() { ::operator delete(data_, kAlignment); }

const char* SphereFilter::instructions() { return kInstructions.name; }

SphereWorld::SphereWorld(const Parts& parts) {
  for (std::size_t p = 0; p < parts.count(); ++p) {
    const Solid& solid = parts.solids[p];
    const Mat3 R = Eigen::Map<const Mat3>(parts.rotation + 9 * p);
    const Vec3 t = Eigen::Map<const Vec3>(parts.translation + 3 * p);
    if (solid.shape) {
      add(p, *solid.shape, R, t);
      continue;
    }
    for (const auto& member : solid.block->members) {
      const auto& at = member->getTransform();
      add(p, static_cast<const coal::ShapeBase&>(*member->collisionGeometry()), R * Mat3(at.getRotation()),
          R * at.getTranslation() + t);
    }
  }
  for (const SphereObstacle& o : obstacles) {
    for (int i = 0; i < 3; ++i) far = std::max(far, std::max(std::abs(o.t[i]), o.half[i]));
  }
  if (!obstacles.empty()) group(0, static_cast<std::uint32_t>(obstacles.size()));
}

std::shared_ptr<const SphereWorld> SphereWorld::of(const Parts& parts) {
  std::call_once(parts.kept->flag, [&parts] { parts.kept->value = std::make_shared<const SphereWorld>(parts); });
  return parts.kept->value;
}

void SphereWorld::add(std::size_t part, const coal::ShapeBase& shape, const Mat3& R, const Vec3& t) {
  SphereObstacle made{};
  made.part = static_cast<std::uint32_t>(part);
  double swept = shape.getSweptSphereRadius();
  Vec3 half = Vec3::Zero(), middle = Vec3::Zero();
  switch (shape.getNodeType()) {
    case coal::GEOM_SPHERE:
      made.kind = SphereObstacle::kBall;
      swept += static_cast<const coal::Sphere&>(shape).radius;
      break;
    case coal::GEOM_CAPSULE:
      made.kind = SphereObstacle::kRod;
      half[2] = static_cast<const coal::Capsule&>(shape).halfLength;
      swept += static_cast<const coal::Capsule&>(shape).radius;
      break;
    case coal::GEOM_BOX: {
      const Mat3 sizes = R.cwiseAbs();
      made.kind = sizes.cwiseMin((sizes.array() - 1.0).abs().matrix()).maxCoeff() < kUpright ? SphereObstacle::kUpright
                                                                                             : SphereObstacle::kBox;
      half = static_cast<const coal::Box&>(shape).halfSide;
      if (made.kind == SphereObstacle::kUpright) half = sizes * half;
      break;
    }
    case coal::GEOM_CYLINDER: {
      const auto& can = static_cast<const coal::Cylinder&>(shape);
      made.kind = SphereObstacle::kCan;
      half = Vec3(can.radius, can.radius, can.halfLength);
      break;
    }
    default: {
      made.kind = SphereObstacle::kHull;
      const Hull hull(shape);
      Vec3 low = hull.corners[0], high = hull.corners[0];
      for (const Vec3& p : hull.corners) {
        low = low.cwiseMin(p);
        high = high.cwiseMax(p);
      }
      half = 0.5 * (high - low);
      middle = 0.5 * (high + low);
      auto planes = std::make_unique<std::vector<float>>();
      for (std::size_t k = 0; k < hull.normals.size(); ++k) {
        const Vec3 n = R * hull.normals[k];
        for (int i = 0; i < 3; ++i) planes->push_back(static_cast<float>(n[i]));
        planes->push_back(static_cast<float>(hull.outer[k] + n.dot(t)));
      }
      made.planes = static_cast<std::uint32_t>(hull.normals.size());
      made.plane = planes->data();
      planes_.push_back(std::move(planes));
    }
  }
  made.swept = static_cast<float>(swept);
  const bool upright = made.kind == SphereObstacle::kUpright;
  const Vec3 reach = (upright ? half : Vec3(R.cwiseAbs() * half)) + Vec3::Constant(swept), center = t + R * middle;
  for (int i = 0; i < 9; ++i) made.R[i] = static_cast<float>(R.data()[i]);
  for (int i = 0; i < 3; ++i) {
    made.t[i] = static_cast<float>(t[i]);
    made.half[i] = static_cast<float>(half[i]);
    made.low[i] = static_cast<float>(center[i] - reach[i]);
    made.high[i] = static_cast<float>(center[i] + reach[i]);
  }
  obstacles.push_back(made);
}

// The tree over obstacles first … first + count - 1, which are sorted on the way.
void SphereWorld::group(std::uint32_t first, std::uint32_t count) {
  const std::size_t at = branches.size();
  SphereBranch made{{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}, 0, first, 0};
  for (std::uint32_t k = first; k < first + count; ++k) {
    for (int i = 0; i < 3; ++i) {
      made.low[i] = std::min(made.low[i], obstacles[k].low[i]);
      made.high[i] = std::max(made.high[i], obstacles[k].high[i]);
    }
  }
  branches.push_back(made);
  if (count <= kGrouped) {
    branches[at].count = count;
  } else {
    int axis = 0;
    for (int i = 1; i < 3; ++i) {
      if (made.high[i] - made.low[i] > made.high[axis] - made.low[axis]) axis = i;
    }
    const auto begin = obstacles.begin() + first;
    std::nth_element(begin, begin + count / 2, begin + count, [axis](const SphereObstacle& a, const SphereObstacle& b) {
      return a.low[axis] + a.high[axis] < b.low[axis] + b.high[axis];
    });
    group(first, count / 2);
    group(first + count / 2, count - count / 2);
  }
  branches[at].next = static_cast<std::uint32_t>(branches.size());
}

SphereFilter::SphereFilter(const Bodies& bodies, const Parts& parts, const std::vector<std::int64_t>& self_pairs,
                           double margin, double self_margin)
    : bodies_(bodies), world_(SphereWorld::of(parts)) {
  const Tree& tree = bodies_.tree;
  for (int i = 0; i < tree.joints; ++i) {
    parents_.push_back(static_cast<std::int32_t>(tree.parents[i]));
    kind_.push_back(tree.motion[i] < 0 ? 0 : tree.prismatic[i] ? 2 : 1);
    for (int k = 0; k < 12; ++k) offset_.push_back(static_cast<float>(tree.offset[16 * i + k]));
  }
  for (std::size_t g = 0; g < bodies_.size(); ++g) {
    bool moves = tree.planar;
    for (int m = 0; m < tree.motions(); ++m) moves = moves || tree.supports(bodies_.joint[g], m);
    moves_.push_back(moves);
    if (moves) body_order_.push_back(static_cast<std::uint32_t>(g));
    joint_.push_back(static_cast<std::int32_t>(bodies_.joint[g]));
    const std::uint32_t first = static_cast<std::uint32_t>(outer_.size());
    first_.push_back(first);
    const Mat3 R = Eigen::Map<const Mat3>(&bodies_.rotation[9 * g]);
    const Vec3 t = Eigen::Map<const Vec3>(&bodies_.translation[3 * g]);
    for (const SphereTree::Sphere& s : bodies_.spheres()[g].spheres) {
      const Vec3 center = R * Vec3(s.center[0], s.center[1], s.center[2]) + t;
      for (int i = 0; i < 3; ++i) center_.push_back(static_cast<float>(center[i]));
      outer_.push_back(s.outer);
      inner_.push_back(s.inner);
      next_.push_back(first + s.next);
    }
  }
  for (std::size_t s = 0; s < self_pairs.size() / 2; ++s) {
    const std::size_t a = self_pairs[2 * s], b = self_pairs[2 * s + 1];
    pair_.insert(pair_.end(), {static_cast<std::uint32_t>(a), static_cast<std::uint32_t>(b)});
    if (moves_[a] || moves_[b]) pair_order_.push_back(static_cast<std::uint32_t>(s));
  }
  const std::size_t count = world_->obstacles.size(), joints = static_cast<std::size_t>(tree.joints);
  stamp_.assign(outer_.size(), 0);
  near_.resize(count);
  opened_.resize(count);
  pending_.resize(kLevels * count);
  values_ = std::make_unique<Aligned>(joints * 3 * kRows);
  T_ = std::make_unique<Aligned>(joints * 12 * kRows);
  at_ = std::make_unique<Aligned>(outer_.size() * 3 * kRows);
  scratch_ = {values_->data(), T_->data(),   at_->data(),   stamp_.data(), 0,
              pending_.data(), near_.data(), opened_.data()};
  scene_ = {tree.joints,
            parents_.data(),
            kind_.data(),
            offset_.data(),
            body_order_.size(),
            pair_order_.size(),
            count,
            world_->branches.size(),
            joint_.data(),
            first_.data(),
            next_.data(),
            center_.data(),
            outer_.data(),
            inner_.data(),
            pair_.data(),
            world_->obstacles.data(),
            world_->branches.data(),
            static_cast<float>(margin - bodies_.skin),
            static_cast<float>(self_margin),
            0.0f,
            body_order_.data(),
            pair_order_.data(),
            nullptr,
            nullptr};
  open_.resize(64);
}

// What the joints do in each row, and how much rounding may take.
void SphereFilter::set_out(const double* rows, std::size_t count) {
  const Tree& tree = bodies_.tree;
  const std::size_t nv = static_cast<std::size_t>(tree.nv);
  float far = world_->far;
  for (std::size_t n = 0; tree.planar && n < count; ++n) {
    far = std::max(far, static_cast<float>(std::max(std::abs(rows[n * nv]), std::abs(rows[n * nv + 1]))));
  }
  scene_.pad = kLeastPad + kPadPerMetre * far;
  for (int i = 1; i < tree.joints; ++i) {
    const std::int64_t m = tree.motion[i];
    float* values = scratch_.values + 3 * kRows * static_cast<std::size_t>(i);
    for (std::size_t n = 0; n < kRows; ++n) {
      const double* q = rows + std::min(n, count - 1) * nv;
      double turned = m < 0 ? q[2] : tree.rate[m] * q[tree.coordinate[m]] + tree.shift[m];
      if (kind_[i] != 2) turned -= kTurn * std::nearbyint(turned / kTurn);
      if (m < 0) {
        values[n] = static_cast<float>(q[0]);
        values[kRows + n] = static_cast<float>(q[1]);
        values[2 * kRows + n] = static_cast<float>(turned);
      } else {
        values[n] = static_cast<float>(turned);
      }
    }
  }
  if (scratch_.stamped > UINT32_MAX - 4 * kRows) {
    std::fill(stamp_.begin(), stamp_.end(), 0);
    scratch_.stamped = 0;
  }
}

unsigned SphereFilter::run(unsigned rows, bool first) {
  std::size_t opened;
  open_.resize(open_.capacity());
  unsigned hit = kInstructions.look(scene_, scratch_, rows, first, open_.data(), open_.size(), opened);
  if (opened > open_.size()) {  // there was no room for them all
    open_.resize(2 * opened);
    hit = kInstructions.look(scene_, scratch_, rows, first, open_.data(), open_.size(), opened);
  }
  open_.resize(opened);
  return hit;
}

unsigned SphereFilter::look(const double* rows, std::size_t count, bool first, std::vector<std::uint32_t>* alone) {
  set_out(rows, count);
  const SphereScene before = scene_;
  if (alone != nullptr) {
    scene_.bodies = alone->size();
    scene_.body_order = alone->data();
    scene_.pairs = 0;
  }
  const unsigned hit = run((1u << count) - 1u, first);
  scene_ = before;
  if (hit != 0) {
    open_.erase(std::remove_if(open_.begin(), open_.end(), [hit](const SphereOpen& o) { return hit >> o.row & 1; }),
                open_.end());
  }
  return hit;
}

void SphereFilter::look_grown(const double* rows, std::size_t count, const float* grown, const float* pair_grown,
                              std::vector<std::uint32_t>* bodies, std::vector<std::uint32_t>* pairs) {
  set_out(rows, count);
  const SphereScene before = scene_;
  scene_.grown = grown;
  scene_.pair_grown = pair_grown;
  if (bodies != nullptr) {
    scene_.bodies = bodies->size();
    scene_.pairs = pairs->size();
    scene_.body_order = bodies->data();
    scene_.pair_order = pairs->data();
  }
  run((1u << count) - 1u, false);
  scene_ = before;
}

}  // namespace strips
