#include "geometry.hpp"

#include <coal/broadphase/default_broadphase_callbacks.h>
#include <coal/narrowphase/support_functions.h>

#include <algorithm>
#include <cmath>

namespace strips {

static coal::DistanceRequest request(double gjk, double epa) {
  coal::DistanceRequest made(true);
  if (gjk > 0.0) made.gjk_tolerance = gjk;
  if (epa > 0.0) made.epa_tolerance = epa;
  return made;
}

static bool is(const coal::ShapeBase& shape, coal::NODE_TYPE type) { return shape.getNodeType() == type; }

static std::shared_ptr<coal::ShapeBase> of_kind(const std::string& kind, const std::vector<double>& s) {
  if (kind == "box" && s.size() == 3) return std::make_shared<coal::Box>(s[0], s[1], s[2]);
  if (kind == "sphere" && s.size() == 1) return std::make_shared<coal::Sphere>(s[0]);
  if (kind == "cylinder" && s.size() == 2) return std::make_shared<coal::Cylinder>(s[0], s[1]);
  if (kind == "capsule" && s.size() == 2) return std::make_shared<coal::Capsule>(s[0], s[1]);
  if (kind == "cone" && s.size() == 2) return std::make_shared<coal::Cone>(s[0], s[1]);
  if (kind == "ellipsoid" && s.size() == 3) return std::make_shared<coal::Ellipsoid>(s[0], s[1], s[2]);
  throw std::invalid_argument("no shape of kind '" + kind + "' with " + std::to_string(s.size()) + " sizes");
}

double reach_of(const coal::ShapeBase& shape, const Vec3& direction) {
  int hint = 0;
  return direction.dot(
      coal::details::getSupport<coal::details::SupportOptions::WithSweptSphere>(&shape, direction, hint));
}

static Solid finished(std::shared_ptr<coal::ShapeBase> shape, double swept) {
  shape->setSweptSphereRadius(swept);
  shape->computeLocalAABB();
  return {std::move(shape), nullptr};
}

Solid primitive(const std::string& kind, const std::vector<double>& size, double swept) {
  return finished(of_kind(kind, size), swept);
}

Solid convex(const double* points, std::size_t count, const std::uint32_t* triangles, std::size_t faces, double swept) {
  auto corners = std::make_shared<std::vector<coal::Vec3s>>();
  for (std::size_t i = 0; i < count; ++i) corners->emplace_back(points[3 * i], points[3 * i + 1], points[3 * i + 2]);
  auto polygons = std::make_shared<std::vector<coal::Triangle>>();
  for (std::size_t i = 0; i < faces; ++i) {
    polygons->emplace_back(triangles[3 * i], triangles[3 * i + 1], triangles[3 * i + 2]);
  }
  return finished(std::make_shared<coal::Convex<coal::Triangle>>(corners, static_cast<unsigned>(count), polygons,
                                                                 static_cast<unsigned>(faces)),
                  swept);
}

Solid block(const double* sides, const double* at, std::size_t count) {
  auto made = std::make_shared<Block>();
  for (std::size_t i = 0; i < count; ++i) {
    auto box = std::make_shared<coal::Box>(sides[3 * i], sides[3 * i + 1], sides[3 * i + 2]);
    made->members.push_back(std::make_unique<coal::CollisionObject>(
        box, coal::Matrix3s::Identity(), coal::Vec3s(at[3 * i], at[3 * i + 1], at[3 * i + 2])));
    made->tree.registerObject(made->members.back().get());
  }
  made->tree.setup();
  return {nullptr, made};
}

std::shared_ptr<coal::ShapeBase> sphere_as_capsule(const std::shared_ptr<coal::ShapeBase>& shape) {
  if (!is(*shape, coal::GEOM_SPHERE)) return shape;
  auto capsule = std::make_shared<coal::Capsule>(static_cast<const coal::Sphere&>(*shape).radius, 0.0);
  capsule->computeLocalAABB();
  return capsule;
}

// Coal's closed form for a sphere and a cylinder forgets the cylinder's caps once the sphere's centre is inside.
static std::shared_ptr<coal::ShapeBase> for_penetration(const std::shared_ptr<coal::ShapeBase>& shape,
                                                        const coal::ShapeBase& other) {
  return is(*shape, coal::GEOM_SPHERE) && is(other, coal::GEOM_CYLINDER) ? sphere_as_capsule(shape) : shape;
}

// How far a shape extends along a vector of its frame.
static double support(const coal::ShapeBase& shape, const Vec3& n) {
  int hint = 0;
  if (!is(shape, coal::GEOM_CONVEX)) {
    return coal::details::getSupport<coal::details::WithSweptSphere>(&shape, n, hint).dot(n);
  }
  const auto& points = *static_cast<const coal::ConvexBase&>(shape).points;
  double most[4] = {-INFINITY, -INFINITY, -INFINITY, -INFINITY};  // side by side: none waits for the other
  std::size_t k = 0;
  for (; k + 4 <= points.size(); k += 4) {
    for (std::size_t i = 0; i < 4; ++i) most[i] = std::max(most[i], points[k + i].dot(n));
  }
  for (; k < points.size(); ++k) most[0] = std::max(most[0], points[k].dot(n));
  return std::max(std::max(most[0], most[1]), std::max(most[2], most[3])) + shape.getSweptSphereRadius();
}

// How far two shapes are apart along a unit vector from one to the other: no more than their distance, wherever the
// vector comes from; -inf where it is none.
static double gap(const ShapePair& pair, const Transform3s& one, const Transform3s& two, const Vec3& n) {
  if (!(n.squaredNorm() < 1.0 + UNIT_EXCESS)) return -INFINITY;
  return n.dot(two.getTranslation() - one.getTranslation()) - support(*pair.one, one.getRotation().transpose() * n) -
         support(*pair.two, -(two.getRotation().transpose() * n));
}

ShapePair::ShapePair(std::shared_ptr<coal::ShapeBase> a, std::shared_ptr<coal::ShapeBase> b)
    : one(std::move(a)),
      two(std::move(b)),
      deep_one(for_penetration(one, *two)),
      deep_two(for_penetration(two, *one)),
      apart(one.get(), two.get()),
      deep(deep_one.get(), deep_two.get()),
      fine(deep_one.get(), deep_two.get()) {}

PairSolver::PairSolver()
    : apart_(request(GJK_TOLERANCE, 0.0)),
      touch_(request(0.0, 0.0)),
      deep_(request(0.0, 0.0)),
      fine_(request(GJK_TOLERANCE, EPA_TOLERANCE)) {
  touch_.enable_signed_distance = false;
  for (double tolerance : COARSE_EPA_TOLERANCES) coarse_.push_back(request(0.0, tolerance));
}

double PairSolver::ask(const ShapePair& pair, const Transform3s& one, const Transform3s& two) {
  result_.clear();
  const double d = pair.apart(one, two, shallow ? touch_ : apart_, result_);
  if (shallow) return std::max(d, 0.0);
  return proven(pair, one, two, d > 0.0 ? d : penetration(pair, one, two));
}

double PairSolver::proven(const ShapePair& pair, const Transform3s& one, const Transform3s& two, double d) {
  if (d <= 0.0) return d;
  const double apart = gap(pair, one, two, result_.normal);
  if (d <= apart + NORMAL_EXCESS) return d;
  result_.clear();
  pair.deep(one, two, deep_, result_);
  return std::max({gap(pair, one, two, result_.normal), apart, 0.0});
}

double PairSolver::penetration(const ShapePair& pair, const Transform3s& one, const Transform3s& two) {
  result_.clear();
  double deep = pair.deep(one, two, deep_, result_);
  result_.clear();
  const double fine = pair.fine(one, two, fine_, result_);
  if (fine > NO_DEPTH && std::abs(fine - deep) < DEPTH_AGREEMENT) return fine;
  for (std::size_t k = 0; k <= coarse_.size(); ++k) {  // even Coal's own tolerance is not always reached
    result_.clear();
    deep = pair.deep(one, two, k == 0 ? deep_ : coarse_[k - 1], result_);
    if (deep > NO_DEPTH) return deep;
  }
  throw Failure("NumericalError", "Coal finds no penetration depth of two shapes at any tolerance");
}

double PairSolver::ask(const Block& block, coal::CollisionObject& probe) {
  coal::DistanceCallBackDefault callback;
  callback.data.request = apart_;
  block.tree.distance(&probe, &callback);
  result_ = callback.data.result;
  if (result_.min_distance > 0.0) return result_.min_distance;
  // The tree stops at the first box that penetrates; the deepest one is wanted. None is deeper than its bounds and the
  // probe's overlap, so those that overlap most come first.
  using Member = std::pair<double, coal::CollisionObject*>;
  std::vector<Member> members;
  for (const auto& member : block.members) {
    const coal::AABB &a = member->getAABB(), &b = probe.getAABB();
    members.emplace_back((a.max_ - b.min_).cwiseMin(b.max_ - a.min_).minCoeff(), member.get());
  }
  std::sort(members.begin(), members.end(), [](const Member& a, const Member& b) { return a.first > b.first; });
  coal::DistanceResult deepest;
  double least = INFINITY;
  for (const auto& [overlap, member] : members) {
    if (least <= -overlap) break;
    result_.clear();
    coal::distance(member, &probe, deep_, result_);
    if (result_.min_distance < least) {
      least = result_.min_distance;
      deepest = result_;
    }
  }
  result_ = deepest;
  return least;
}

}  // namespace strips
