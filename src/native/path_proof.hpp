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
 public:
  // `radius` (M, G) and `self_radius` (nv, S) bound how fast points move, as those of Certifier do.
  PathProof(std::shared_ptr<const Bodies> bodies, const Parts& parts, std::vector<std::int64_t> self_pairs,
            const double* radius, const double* self_radius);

  // Rows (n, nv) and the tangents (n-1, nv) between them. States (n-1): 0 where a segment is proven, else 1. With `all`
  // the first that is not proven ends it, and all are 1.
  void prove(const double* rows, const double* v, std::size_t n, double clearance, double self_clearance, int depth,
             bool all, std::int8_t* states);

  const Tree& tree() const { return bodies_->tree; }
  std::size_t checks = 0, queries = 0;

 private:
  struct Piece {
    std::size_t segment;
    double low, high;
    int depth;
    std::vector<std::uint32_t> bodies, pairs;  // what is open
  };
  struct Asked {
    const double *rows, *v;
    double clearance, self_clearance;
    int depth;
    bool all;
  };
  bool look(Piece* now, std::size_t filled, Piece* of, std::int8_t* states);
  bool rest_is_clear(const double* row, double clearance, double self_clearance);
  double exact(const SphereOpen& open, const double* row, bool& placed, Queries& ask);

  std::shared_ptr<const Bodies> bodies_;
  Narrowphase narrow_;
  SelfPairs self_;
  const Parts& parts_;
  Bounds bounds_;
  const double* self_radius_;
  SphereFilter filter_;
  Aligned grown_, pair_grown_;
  std::vector<double> T_, rows_, travel_, self_travel_;  // (N-1, G), (N-1, S)
  std::vector<Piece> todo_;
  Asked ask_{};
};

}  // namespace strips
