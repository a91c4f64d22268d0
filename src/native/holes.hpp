// Holes of an image: pixels without an answer, and what may be hidden in them.
#pragma once

#include <cstddef>

namespace strips {

// Ranges (rows, columns) of an image with narrow holes of lost ones, which are no numbers, filled in; see `filled` in
// elastic_strips.perception.lost_pixels, its twin. Holes up to `widest` pixels are looked into.
void fill_holes(const float* ranges, std::size_t rows, std::size_t columns, double unit, int widest, float* out);

}  // namespace strips
