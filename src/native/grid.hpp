// Grids seen from above, for paths of the base: which cells obstacles take, how far they are, and the cheapest path.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace strips {

// Cells (rows, columns), the first index along x: where the middle of the first one is, and their edge [m].
struct Cells {
  std::size_t rows, columns;
  const double* low;
  double resolution;
};

// Convex outlines: their owners (K), how far each reaches along unit vectors (D, 2) evenly all around, the first along
// x, from its place (K, 2). D is a multiple of four.
struct Outlines {
  const std::int64_t* whose;
  const double *reach, *at, *around;
  std::size_t count, directions;
};

// Gives the cells within half a cell of an outline to its owner; of several outlines the last one gets them.
void fill_outlines(const Outlines& outlines, const Cells& cells, std::int64_t* owner);

// Distance [m] of each cell's middle to the nearest cell that is taken; infinite where none is.
void clearance_map(const bool* taken, std::size_t rows, std::size_t columns, double resolution, double* clear);

// The cost of each of `count` cells: 1 where there is more clearance than `inner` by `comfort`, ever more towards
// `inner`, where it is `narrow`, and infinite below.
void cell_cost(const double* clear, std::size_t count, double inner, double comfort, double narrow, double* cost);

// The cheapest path between two cells: their numbers, row by row; none where there is no path. A move costs its length
// in cells by the mean cost of both ends. `cost` is that of a cell, infinite or no number where it is closed; the
// largest has to be within kLargestRatio of the least, which is positive.
std::vector<std::int64_t> cheapest_route(const double* cost, std::size_t rows, std::size_t columns, std::size_t first,
                                         std::size_t last);

constexpr double kLargestRatio = 1e4;  // of the costs of two cells: the search keeps a list for each step of the least

}  // namespace strips
