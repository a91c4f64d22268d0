// A map of space in voxels about a robot: what images of depths or ranges surely see through, and where they end.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace strips {

// Where the pixels of an image look, in the frame of its sensor. A camera looks along z, x to the right and y down; the
// middle of the first pixel has the coordinates 0, 0. A range finder that turns has azimuths about z, from x on, in its
// columns, and elevations in its rows.
struct Optics {
  std::size_t rows, columns;
  bool camera, round;  // round: the last column is beside the first
  double scale[2];     // focal lengths [px], or pixels a radian, of columns and of rows; of ranges of either sign
  double middle[2];    // pixel coordinates of the axis z, or of azimuth and elevation 0
};

struct Sight {
  Optics optics;
  const float* clear;               // (rows, columns) depth or range to which a pixel surely sees [m]; 0: unknown
  const double *rotation, *origin;  // of the sensor in the world (3, 3), (3)
  double nearest;                   // depth or range before which nothing is seen [m]
  double sure;                      // and from which on pixels are too far apart to see all that there is
  double exact;                     // up to which it is known to less than a voxel where pixels end
};

// Log-odds that a sight adds, their bounds, and between which a voxel stays what it was, an obstacle or none.
struct Evidence {
  int miss, floor, top, filled, emptied;
};

class VolumeMap {
 public:
  static constexpr int EDGE = 8;  // voxels along a block
  static constexpr int VOLUME = EDGE * EDGE * EDGE;
  static constexpr std::int8_t UNSEEN = -128;
  static constexpr std::int8_t PASSED = -127;  // seen through, by pixels that are too far apart to see what is thin
  using Block = std::array<std::int64_t, 3>;

  // A window of so many blocks (3) of voxels that are `cell` wide [m], from block `corner` (3) of space on.
  VolumeMap(const std::int64_t* blocks, const std::int64_t* corner, double cell, const Evidence& evidence);

  // The window begins at another block: what leaves it is forgotten.
  void roll(const std::int64_t* corner);

  // Points (n, 3) [m] at which rays ended, and what each of them is as evidence (n), 0 for what is not to be in the
  // map. A voxel takes the most that it is hit with. `before` (n) is what was known of its voxel.
  void hit(const double* points, const std::int8_t* weight, std::size_t count, std::int8_t* before);

  // Free what is surely seen through, but not what the last `hit` hit. Where pixels are too far apart, obstacles only
  // become what was never seen, and what was never seen has been passed, which is as unknown. Of what was never seen,
  // what is seen beyond the middle of is neither.
  void carve(const Sight& sight);

  // What is known of the voxels that points (n, 3) [m] lie in; UNSEEN outside of the window.
  void look(const double* points, std::size_t count, std::int8_t* known) const;

  // Of the voxels of points (n, 3) [m] those that were never seen are neither from now on.
  void grant(const double* points, std::size_t count);

  // Nothing is known any more of the voxels of points (n, 3) [m].
  void forget(const double* points, std::size_t count);

  // Blocks (n, 3) whose obstacles, or whose voxels in doubt, are not what they were when this was last asked. In doubt
  // is what was never seen, and what has been hit and is not an obstacle yet.
  std::vector<std::int64_t> changed(bool doubtful);

  // Boxes (n, 6), low and high in voxels of space, that the obstacles in a block (3), or its voxels in doubt, consist
  // of.
  std::vector<std::int64_t> boxes(const std::int64_t* block, bool doubtful) const;

  // The same without what a map of voxels half as wide knows to be free; low and high in voxels of that.
  std::vector<std::int64_t> boxes(const std::int64_t* block, bool doubtful, const VolumeMap& fine) const;

  // How many voxels are obstacles, or were never seen.
  std::size_t count(bool unseen) const;

 private:
  using Bits = std::array<std::uint64_t, EDGE>;  // bit 8 y + z of word x
  bool inside(const Block& block) const;
  std::size_t slot(const Block& block) const;
  Block block_of(std::size_t at) const;
  bool locate(const double* point, std::size_t& at, int& voxel) const;
  void put(std::size_t at, int voxel, int known, bool neither = false);
  void pass(std::size_t at, int voxel, bool sure);
  void grant(std::size_t at, int voxel);
  void fade(std::size_t at, int voxel);
  bool settled(std::size_t at, const int* first, int edge, bool far) const;
  Bits listed(const Block& block, bool doubtful) const;
  struct Noted {
    std::vector<Block> blocks;
    std::vector<std::uint8_t> among;  // which blocks are among them
  };
  void note(Noted& noted, std::size_t at);

  Block blocks_, corner_;
  double cell_;
  Evidence evidence_;
  std::vector<std::int8_t> known_;         // of each block's voxels: 64 x + 8 y + z
  std::vector<int> floors_, passed_;       // how many of each block's voxels are as free as can be, or were passed
  std::vector<Bits> filled_, sure_, hit_;  // sure: not in doubt
  std::vector<std::size_t> touched_;       // blocks with bits in hit_
  Noted changed_, cleared_;
};

// Of boxes (count) of a grid of cells, from cell `low` (3) to before cell `high`: the middles of their cells (n, 3),
// box by box, and the boxes' middles and edges (count, 3) [m]. `whole` (7): middle and half size (3) of what holds all
// of them, and radius about that. Without `cells` it only counts these.
std::size_t grid_boxes(const std::int64_t* low, const std::int64_t* high, std::size_t count, double cell, double* cells,
                       double* middles, double* edges, double* whole);

}  // namespace strips
