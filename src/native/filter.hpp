// Eight configurations at once by the spheres of the links: which are free of everything, which touch for certain, and
// what only exact shapes decide of the others.
#pragma once

#include "narrowphase.hpp"
#include "sphere_look.hpp"

namespace strips {

// Numbers that begin where the widest instructions ask for.
class Aligned {
 public:
  explicit Aligned(std::size_t count);
  ~Aligned();
  Aligned(const Aligned&) = delete;
  Aligned& operator=(const Aligned&) = delete;
  float* data() const { return data_; }

 private:
  float* data_;
};

// The convex shapes of parts that stay where they are, and a tree of boxes over them.
struct SphereWorld {
  std::vector<SphereObstacle> obstacles;
  std::vector<SphereBranch> branches;
  float far = 0.0f;  // [m] of what stands, from the origin

  explicit SphereWorld(const Parts& parts);
  // That of the parts; made once.
  static std::shared_ptr<const SphereWorld> of(const Parts& parts);

 private:
  void add(std::size_t part, const coal::ShapeBase& shape, const Mat3& R, const Vec3& t);
  void group(std::uint32_t first, std::uint32_t count);

  std::vector<std::unique_ptr<std::vector<float>>> planes_;
};

// Its numbers are of single precision; all that it says holds with as much room as that rounds.
class SphereFilter {
 public:
  SphereFilter(const Bodies& bodies, const Parts& parts, const std::vector<std::int64_t>& self_pairs, double margin,
               double self_margin);

  // Rows (count ≤ 8, nv). What touches for certain is a bit of the answer; with `first` the first ends it. Else
  // `open()` has the pairs of the others that are neither apart nor touching. With `alone` only these bodies are looked
  // at, and no self pairs.
  unsigned look(const double* rows, std::size_t count, bool first, std::vector<std::uint32_t>* alone = nullptr);

  // What may be nearer than zero to something, the spheres of the bodies (G, 8) and of the self pairs (S, 8) grown by
  // so much [m]: `open()` has it. Of certain bodies and pairs alone where they are given.
  void look_grown(const double* rows, std::size_t count, const float* grown, const float* pair_grown,
                  std::vector<std::uint32_t>* bodies, std::vector<std::uint32_t>* pairs);
  const std::vector<SphereOpen>& open() const { return open_; }

  // Whether joints move a body. What none moves is left out: whoever asks looks at it once.
  bool moves(std::size_t body) const { return moves_[body]; }

  // The instructions that are used: "avx512", "avx2" or "baseline".
  static const char* instructions();

 private:
  void set_out(const double* rows, std::size_t count);
  unsigned run(unsigned rows, bool first);

  const Bodies& bodies_;
  const std::shared_ptr<const SphereWorld> world_;
  std::vector<bool> moves_;
  std::vector<std::int32_t> parents_, kind_, joint_;
  std::vector<float> offset_, center_, outer_, inner_;
  std::vector<std::uint32_t> first_, next_, pair_, body_order_, pair_order_;
  std::vector<std::uint32_t> stamp_, near_, opened_;
  std::vector<SphereScratch::Pending> pending_;
  std::unique_ptr<Aligned> values_, T_, at_;
  std::vector<SphereOpen> open_;
  SphereScene scene_{};
  SphereScratch scratch_{};
};

}  // namespace strips
