// Segments of a path proven by the spheres of the links, grown by how far they move; see certificate.py for the lemma.
#pragma once

#include <optional>

#include "certificate.hpp"
#include "filter.hpp"

namespace strips {

// About the middle of an interval no point of a body moves further than half of its travel; so the interval is free
// where the body, grown by that and by the clearance, is. What the spheres leave open is halved, and where it moves
// little the exact distance decides, as much of it as is proven.
class PathProof {
  static constexpr std::size_t kKept = 512;

 public:
  // `radius` (M, G) and `self_radius` (nv, S) bound how fast points move, as those of Certifier do.
  PathProof(std::shared_ptr<const Bodies> bodies, const Parts& parts, std::vector<std::int64_t> self_pairs,
            const double* radius, const double* self_radius);

  // Rows (n, nv) and the tangents (n-1, nv) between them. States (n-1): 0 where a segment is proven, else 1. With `all`
  // the first that is not proven ends it, and all are 1. What is proven keeps a little more than the clearances: what
  // a certificate needs that knows no planes, and that may halve a segment once more than `depth`.
  void prove(const double* rows, const double* v, std::size_t n, double clearance, double self_clearance, int depth,
             bool all, std::int8_t* states);

  // The least distance from all parts along the rows, or `most` where that is less, and at most `tolerance` [m] below
  // it. Throws Failure where two are so deep in each other that there is none.
  double least(const double* rows, const double* v, std::size_t n, double tolerance, double most);

  const Tree& tree() const { return bodies_->tree; }
  std::size_t checks = 0, queries = 0;

 private:
  struct Piece {
    std::size_t segment;
    double low, high;
    int depth;
    std::vector<std::uint32_t> bodies, pairs;  // what is open
    std::vector<double> speed;                 // bounds on how fast points of these bodies move [m]
    double half() const { return 0.5 * (high - low); }
  };
  // How a body moves at the middle of a piece, and a bound on how far it turns in all of it, by those motions that do
  // not move another body likewise.
  struct Motion {
    Vec3 linear = Vec3::Zero(), angular = Vec3::Zero();
    double turning = 0.0;
  };
  struct Normal {
    SphereOpen of{};
    Vec3 normal = Vec3::Zero();
  };
  struct Asked {
    const double *rows, *v;
    double clearance, self_clearance;
    int depth;
    bool all;
    double floor;  // of a segment, what the shortest pieces of a certificate are of its travel, halved
  };
  void at(const double* row, Queries& ask);
  Vec3& kept_normal(const SphereOpen& open);
  Found exact(const SphereOpen& open, Queries& ask);
  bool rest_is_clear(Queries& ask);
  void set_travel(std::size_t n);
  static void divide(const Piece& piece, Piece* now);
  void open_in(const Piece* now, std::size_t filled, Piece* of, double room, double own);
  double speed_in(const Piece& piece, std::size_t body, const Frames& frames, double known);
  Motion motion_in(const Piece& piece, std::size_t body, std::size_t other, const Frames& frames) const;
  double lowest(const Motion& motion, double t, std::size_t body, const Vec3& normal, const Frames& frames) const;
  double beyond_plane(const Piece& piece, const SphereOpen& open, double move, const Vec3& normal,
                      const Frames& at) const;
  bool look(Piece* now, std::size_t filled, Piece* of, Queries& ask, std::int8_t* states);

  std::shared_ptr<const Bodies> bodies_;
  Narrowphase narrow_;
  SelfPairs self_;
  const Parts& parts_;
  Bounds bounds_;
  const double* self_radius_;
  SphereFilter filter_;
  Aligned grown_, pair_grown_;
  std::vector<double> T_, J_, rows_, v_, speed_;  // of one node; (8, nv), (nv), (G, 8)
  std::vector<double> travel_, self_travel_;      // (N-1, G), (N-1, S) of whole segments
  std::vector<std::uint32_t> moved_;              // bodies that joints move
  std::vector<Piece> todo_;
  std::vector<Normal> normals_ = std::vector<Normal>(kKept);  // of the last queries, by a hash of the pair
  Asked ask_{};
};

}  // namespace strips
