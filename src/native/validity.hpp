// Whether a configuration keeps a margin to all obstacles and does not touch itself: what a sampling planner asks.
#pragma once

#include "certificate.hpp"

namespace strips {

class Validity {
 public:
  Validity(std::shared_ptr<const Bodies> bodies, const std::vector<std::shared_ptr<Solid>>& parts,
           std::vector<std::int64_t> self_pairs, const PartPoses& poses, double margin);
  Validity(const Validity&) = delete;
  Validity& operator=(const Validity&) = delete;

  bool valid(const double* coordinates);

 private:
  bool clear_of_parts(const Frames& frames);

  std::shared_ptr<const Bodies> bodies_;
  Narrowphase narrow_;
  SelfPairs self_;
  PartPoses poses_;
  double margin_;
  std::vector<double> low_, high_;  // (P, 3) boxes about the parts in the world, grown by the margin
  std::vector<double> T_;           // placements of one node
  std::vector<std::size_t> near_;
};

}  // namespace strips
