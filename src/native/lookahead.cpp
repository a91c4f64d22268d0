#include "lookahead.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace strips {

static double box_distance(double x, double y, double a, double b) {
  x = std::abs(x) - a;
  y = std::abs(y) - b;
  const double right = std::max(x, 0.0), up = std::max(y, 0.0);
  return std::sqrt(right * right + up * up) + std::min(std::max(x, y), 0.0);
}

// A speed that has changed by at most `most` towards another.
static double nearer(double speed, double target, double most) {
  return speed + std::min(std::max(target - speed, -most), most);
}

void roll_out(const Manoeuvres& m, std::size_t count, std::size_t steps, double* pose) {
  for (std::size_t n = 0; n < count; ++n) {
    const double *first = m.first + m.dim * n, *second = m.second + m.dim * n, *rate = m.rate + m.dim * n;
    const auto done = static_cast<double>(m.done[n]);
    double at[3] = {m.start[0], m.start[1], m.start[2]}, before[3], held[3];
    std::copy_n(m.speed, m.dim, before);
    for (std::size_t j = 0; j < m.dim; ++j) held[j] = nearer(m.speed[j], first[j], m.change[j] * done);
    double angle = at[2], cos = std::cos(angle), sin = std::sin(angle);
    for (std::size_t step = 1; step <= steps; ++step, pose += 3) {
      const auto s = static_cast<double>(step);
      double move[3] = {0.0, 0.0, 0.0};
      for (std::size_t j = 0; j < m.dim; ++j) {
        const double now = s <= done ? nearer(m.speed[j], first[j], m.change[j] * s)
                                     : nearer(held[j], second[j], rate[j] * (s - done));
        for (int i = 0; i < 3; ++i) move[i] += 0.5 * (now + before[j]) * m.twist[3 * j + i];
        before[j] = now;
      }
      at[2] += move[2];
      const double middle = at[2] - 0.5 * move[2];
      if (middle != angle) {  // else it goes straight, or stands
        angle = middle;
        cos = std::cos(angle);
        sin = std::sin(angle);
      }
      at[0] += cos * move[0] - sin * move[1];
      at[1] += sin * move[0] + cos * move[1];
      std::copy_n(at, 3, pose);
    }
  }
}

void near_discs(const Rollout& rollout, const Discs& discs, const double* size, double lookahead, double far) {
  for (std::size_t k = 0; k < rollout.count * rollout.steps; ++k) {
    const double *pose = rollout.pose + 3 * k, t = rollout.time[k % rollout.steps];
    double least = far;
    for (std::size_t m = 0; m < discs.count; ++m) {
      const double *d = discs.disc + 8 * m, vx = d[2], vy = d[3];
      double dx = d[0] + vx * t - pose[0], dy = d[1] + vy * t - pose[1];
      const double closing = -(dx * vx + dy * vy) / std::max(vx * vx + vy * vy, 1e-6);
      const double ahead = std::min(std::max(closing, 0.0), lookahead);
      dx += vx * ahead;
      dy += vy * ahead;
      least = std::min(least, std::sqrt(dx * dx + dy * dy) - size[m]);
    }
    rollout.out[k] = least;
  }
}

void possible_discs(const Rollout& rollout, const Discs& discs, const Footprint& body, double far) {
  double reach = 0.0;
  for (std::size_t b = 0; b < body.count; ++b) {
    const double *middle = body.middle + 2 * b, *half = body.half + 2 * b;
    reach = std::max(reach, std::hypot(std::abs(middle[0]) + half[0], std::abs(middle[1]) + half[1]));
  }
  for (std::size_t k = 0; k < rollout.count * rollout.steps; ++k) {
    const double *pose = rollout.pose + 3 * k, t = rollout.time[k % rollout.steps];
    const double cos = std::cos(pose[2]), sin = std::sin(pose[2]);
    double least = far;
    for (std::size_t m = 0; m < discs.count; ++m) {
      const double *d = discs.disc + 8 * m, *error = discs.error + m;
      const double size = d[4] + error[0] + (error[discs.count] + error[2 * discs.count] * t) * t;
      const double dx = d[0] + d[2] * t - pose[0], dy = d[1] + d[3] * t - pose[1], apart = least + reach + size;
      if (apart > 0.0 && dx * dx + dy * dy > apart * apart) continue;  // even discs about both are
      const double ahead = cos * dx + sin * dy, aside = cos * dy - sin * dx;
      for (std::size_t b = 0; b < body.count; ++b) {
        if (d[5] > body.high[b] || d[6] < body.low[b]) continue;
        const double *middle = body.middle + 2 * b, *half = body.half + 2 * b;
        least = std::min(least, box_distance(ahead - middle[0], aside - middle[1], half[0], half[1]) - size);
      }
    }
    rollout.out[k] = least;
  }
}

void standing_boxes(const Rollout& rollout, const double* boxes, std::size_t count, const Footprint& body, double least,
                    double far) {
  std::vector<double> cos(count), sin(count), round(count);
  for (std::size_t j = 0; j < count; ++j) {
    round[j] = std::hypot(boxes[7 * j + 2], boxes[7 * j + 3]);
    cos[j] = std::cos(boxes[7 * j + 6]);
    sin[j] = std::sin(boxes[7 * j + 6]);
  }
  struct Cover {  // of one box of the robot: discs in rows and columns
    int rows, columns;
    double px, py, radius, outer;
  };
  std::vector<Cover> covers;
  std::vector<std::size_t> close;  // boxes that may count at a pose
  double reach = 0.0;
  for (std::size_t b = 0; b < body.count; ++b) {
    const double *half = body.half + 2 * b, widest = std::max(std::min(half[0], half[1]), least);
    const int nx = static_cast<int>(std::ceil(half[0] / widest)), ny = static_cast<int>(std::ceil(half[1] / widest));
    const double px = half[0] / nx, py = half[1] / ny, radius = std::hypot(px, py);
    covers.push_back({nx, ny, px, py, radius, std::hypot(half[0], half[1]) + radius});
    reach = std::max(reach, far + std::hypot(body.middle[2 * b], body.middle[2 * b + 1]) + covers.back().outer);
  }
  for (std::size_t k = 0; k < rollout.count * rollout.steps; ++k) {
    const double *pose = rollout.pose + 3 * k, c = std::cos(pose[2]), s = std::sin(pose[2]);
    double nearest = far;
    close.clear();
    for (std::size_t j = 0; j < count; ++j) {
      const double ox = pose[0] - boxes[7 * j], oy = pose[1] - boxes[7 * j + 1], apart = reach + round[j];
      if (ox * ox + oy * oy <= apart * apart) close.push_back(j);
    }
    for (std::size_t b = 0; b < body.count; ++b) {
      const double *middle = body.middle + 2 * b, *half = body.half + 2 * b;
      const Cover& cover = covers[b];
      const double x = pose[0] + c * middle[0] - s * middle[1], y = pose[1] + s * middle[0] + c * middle[1];
      for (std::size_t j : close) {
        const double* box = boxes + 7 * j;
        if (box[4] > body.high[b] || box[5] < body.low[b]) continue;
        const double apart = nearest + cover.outer + round[j], ox = x - box[0], oy = y - box[1];
        if (apart > 0.0 && ox * ox + oy * oy > apart * apart) continue;  // even discs about both are
        for (int i = 0; i < cover.rows * cover.columns; ++i) {
          const double u = middle[0] - half[0] + cover.px * (2 * (i / cover.columns) + 1);
          const double w = middle[1] - half[1] + cover.py * (2 * (i % cover.columns) + 1);
          const double dx = pose[0] + c * u - s * w - box[0], dy = pose[1] + s * u + c * w - box[1];
          const double d = box_distance(cos[j] * dx + sin[j] * dy, cos[j] * dy - sin[j] * dx, box[2], box[3]);
          nearest = std::min(nearest, d - cover.radius);
        }
      }
    }
    rollout.out[k] = nearest;
  }
}

}  // namespace strips
