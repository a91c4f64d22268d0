#include "system.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <memory>

namespace strips {

constexpr Eigen::Index kColumns = 8;  // that are solved for together

namespace {

const Failure kNotPositive("NumericalError", "the matrix of the step is not positive definite");

using Block3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

// Base blocks of the difference's derivatives with respect to the first and the second pose.
void difference_jacobians(const double* v, Block3& first, Block3& second) {
  const double theta = v[2], half = 0.5 * theta;
  const bool small = std::abs(theta) < SMALL_TURN;
  const double alpha = small ? 1.0 - theta * theta / 12.0 : half / std::tan(half);
  const double beta = small ? theta / 12.0 : (1.0 - alpha) / theta;
  first << -alpha, -half, -beta * v[0] + 0.5 * v[1], half, -alpha, -beta * v[1] - 0.5 * v[0], 0.0, 0.0, -1.0;
  second << alpha, -half, beta * v[0] + 0.5 * v[1], half, alpha, beta * v[1] - 0.5 * v[0], 0.0, 0.0, 1.0;
}

}  // namespace

double add_elastic(System& s, bool planar, const double* v, const double* weight) {
  const int nv = static_cast<int>(s.nv), b = planar ? 3 : 0;
  const std::size_t block = static_cast<std::size_t>(nv) * nv;
  double energy = 0.0;
  for (std::size_t j = 0; j + 1 < s.nodes; ++j) {
    const double* u = v + j * nv;
    double *here = s.force + j * nv, *there = here + nv;
    double *D0 = s.diagonal + j * block, *D1 = D0 + block, *U = s.upper + j * block;
    for (int k = 0; k < nv; ++k) energy += weight[k] * u[k] * u[k];
    if (b != 0) {
      Block3 first, second;
      difference_jacobians(u, first, second);
      const Vec3 w(weight[0], weight[1], weight[2]), pull = w.cwiseProduct(Vec3(u[0], u[1], u[2]));
      const Block3 W0 = w.asDiagonal() * first, W1 = w.asDiagonal() * second;
      const Eigen::OuterStride<> stride(nv);
      const auto add = [&](double* to, const Block3& more) {
        Eigen::Map<Block3, 0, Eigen::OuterStride<>>(to, stride) += more;
      };
      Eigen::Map<Vec3>(here) -= first.transpose() * pull;
      Eigen::Map<Vec3>(there) -= second.transpose() * pull;
      add(D0, first.transpose() * W0);
      add(D1, second.transpose() * W1);
      add(U, first.transpose() * W1);
    }
    for (int k = b; k < nv; ++k) {
      const double pull = weight[k] * u[k];
      here[k] += pull;
      there[k] -= pull;
      D0[k * nv + k] += weight[k];
      D1[k * nv + k] += weight[k];
      U[k * nv + k] -= weight[k];
    }
  }
  return 0.5 * energy;
}

void add_row(System& s, std::size_t node, const double* row, double force, double stiffness) {
  const int nv = static_cast<int>(s.nv);
  double *f = s.force + node * nv, *D = s.diagonal + node * nv * nv;
  for (int r = 0; r < nv; ++r) {
    f[r] += force * row[r];
    const double scaled = stiffness * row[r];
    if (scaled == 0.0) continue;
    for (int c = 0; c < nv; ++c) D[r * nv + c] += scaled * row[c];
  }
}

void add_directional(const Tree& tree, const double* J, std::int64_t joint, const double* p, const double* n,
                     double* row) {
  const double moment[3] = {p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]};
  for (int m = 0; m < tree.motions(); ++m) {
    if (!tree.supports(joint, m)) continue;
    const double* c = J + 6 * m;
    row[tree.coordinate[m]] +=
        c[0] * n[0] + c[1] * n[1] + c[2] * n[2] + c[3] * moment[0] + c[4] * moment[1] + c[5] * moment[2];
  }
}

double add_repulsion(System& s, const Bodies& bodies, const double* J, const Distances& d, double influence, double k_r,
                     double near, double k_near) {
  const Tree& tree = bodies.tree;
  const double* exact = d.exact;
  double energy = 0.0;
  std::vector<double> row(tree.nv);
  for (std::size_t n = 0; n < d.nodes; ++n) {
    for (std::size_t g = 0; g < d.bodies; ++g) {
      for (std::size_t k = d.begin(n, g), end = d.end(n, g); k < end; ++k) {
        if (!(exact[k] < influence && d.since[k] <= d.limit[d.part[k]])) continue;
        const double gap = influence - exact[k], deep = k_near > 0.0 ? std::max(near - exact[k], 0.0) : 0.0;
        energy += 0.5 * (k_r * gap * gap + k_near * deep * deep);
        std::fill(row.begin(), row.end(), 0.0);
        add_directional(tree, J + n * tree.motions() * 6, bodies.joint[g], d.witness + 3 * k, d.direction + 3 * k,
                        row.data());
        add_row(s, n, row.data(), k_r * gap + k_near * deep, k_r + (deep > 0.0 ? k_near : 0.0));
      }
    }
  }
  return energy;
}

double add_self_repulsion(System& s, const SelfPairs& pairs, const Frames& frames, const SelfDistances& d,
                          const double* repulsion, double k_s) {
  const Tree& tree = pairs.bodies().tree;
  double energy = 0.0;
  std::vector<double> row(tree.nv);
  for (std::size_t n = 0; n < d.nodes; ++n) {
    const double *T = frames.at(pairs.planar() ? 1 : 0, n), *J = frames.J + n * tree.motions() * 6;
    for (std::size_t p = 0, k = n * d.pairs; p < d.pairs; ++p, ++k) {
      if (!(d.exact[k] < repulsion[p] && d.since[k] <= d.tolerance)) continue;
      const double gap = repulsion[p] - d.exact[k];
      const Vec3 one = moved(T, d.first + 3 * k), two = moved(T, d.second + 3 * k);
      const Vec3 along = moved(T, d.direction + 3 * k) - Vec3(T[3], T[7], T[11]), back = -along;
      energy += 0.5 * k_s * gap * gap;
      std::fill(row.begin(), row.end(), 0.0);
      add_directional(tree, J, pairs.joint(p, 0), one.data(), along.data(), row.data());
      add_directional(tree, J, pairs.joint(p, 1), two.data(), back.data(), row.data());
      add_row(s, n, row.data(), k_s * gap, k_s);
    }
  }
  return energy;
}

double add_posture(System& s, const double* coordinates, const double* target, const double* k_p,
                   const std::uint8_t* circular, std::size_t base_nv) {
  double energy = 0.0;
  for (std::size_t n = 0; n < s.nodes; ++n) {
    for (std::size_t k = base_nv; k < s.nv; ++k) {
      double off = coordinates[n * s.nv + k] - target[n * s.nv + k];
      if (circular[k - base_nv]) off = std::atan2(std::sin(off), std::cos(off));
      energy += 0.5 * k_p[k] * off * off;
      s.force[n * s.nv + k] -= k_p[k] * off;
      s.diagonal[(n * s.nv + k) * s.nv + k] += k_p[k];
    }
  }
  return energy;
}

void solve(const System& s, const double* damping, double* delta) {
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const Eigen::Index nv = s.nv;
  const std::size_t n = s.nodes;
  const auto part = [&](std::size_t node) { return Eigen::Map<Eigen::VectorXd>(delta + node * nv, nv); };
  std::fill(delta, delta + n * nv, 0.0);
  if (n < 3) return;
  const std::unique_ptr<double[]> factors(new double[2 * n * nv * nv]);  // of each inner block L of L Lᵀ, and L⁻¹ U
  const auto L = [&](std::size_t i) { return Eigen::Map<Matrix>(&factors[2 * i * nv * nv], nv, nv); };
  const auto W = [&](std::size_t i) { return Eigen::Map<Matrix>(&factors[(2 * i + 1) * nv * nv], nv, nv); };
  std::vector<Eigen::Index> first(nv, 0);  // of the columns from k on, the first row of L⁻¹ U that is not 0
  for (std::size_t i = 1; i + 1 < n; ++i) {
    auto D = L(i);
    D = Eigen::Map<const Matrix>(s.diagonal + i * nv * nv, nv, nv);
    D.diagonal() += Eigen::Map<const Eigen::VectorXd>(damping, nv);
    part(i) = Eigen::Map<const Eigen::VectorXd>(s.force + i * nv, nv);
    if (i > 1) {
      const auto before = W(i - 1);
      for (Eigen::Index k = 0; k < nv; k += kColumns) {
        const Eigen::Index rest = nv - k, top = first[k], width = std::min(kColumns, rest);
        D.block(k, k, rest, width).noalias() -=
            before.block(top, k, nv - top, rest).transpose() * before.block(top, k, nv - top, width);
      }
      part(i).noalias() -= before.transpose() * part(i - 1);
    }
    Eigen::Ref<Matrix> in_place(D);
    if (!D.allFinite() || Eigen::LLT<Eigen::Ref<Matrix>>(in_place).info() != Eigen::Success) throw kNotPositive;
    auto x = part(i);
    D.triangularView<Eigen::Lower>().solveInPlace(x);
    if (i + 2 >= n) continue;
    auto after = W(i);
    after = Eigen::Map<const Matrix>(s.upper + i * nv * nv, nv, nv);
    // what springs couple are mostly joints with themselves: most of what is above the diagonal stays 0
    Eigen::Index top = nv;
    for (Eigen::Index k = (nv - 1) / kColumns * kColumns; k >= 0; k -= kColumns) {
      const Eigen::Index width = std::min(kColumns, nv - k);
      Eigen::Index zeros = 0;
      while (zeros < top && (after.block(zeros, k, 1, width).array() == 0.0).all()) ++zeros;
      first[k] = top = std::min(top, zeros);
      auto rows = after.block(zeros, k, nv - zeros, width);
      D.bottomRightCorner(nv - zeros, nv - zeros).triangularView<Eigen::Lower>().solveInPlace(rows);
    }
  }
  for (std::size_t i = n - 2; i > 0; --i) {
    auto x = part(i);
    if (i + 2 < n) x.noalias() -= W(i) * part(i + 1);
    L(i).triangularView<Eigen::Lower>().transpose().solveInPlace(x);
  }
  if (!std::all_of(delta, delta + n * nv, [](double x) { return std::isfinite(x); })) throw kNotPositive;
}

double project_rolling(double* coordinates, std::size_t n, int nv, int iterations, int& taken) {
  const Space plane{3, true, {}};
  const std::size_t m = n - 1;
  const Vec3 inverse_mass(1.0, 1.0, 1.0 / ROLLING_YAW_WEIGHT);
  std::vector<Vec3> row_a(m), row_b(m), step(n);
  std::vector<double> v(3 * m), diagonal(m), off(m), multiplier(m);
  double residual = INFINITY;
  for (taken = 0; taken <= iterations; ++taken) {
    residual = 0.0;
    for (std::size_t j = 0; j < m; ++j) {
      difference(plane, coordinates + j * nv, coordinates + (j + 1) * nv, &v[3 * j]);
      const double aside = std::abs(v[3 * j + 1]);
      if (!(aside <= residual)) residual = aside;  // NaN as well
    }
    if (residual <= ROLLING_TOLERANCE || taken == iterations || n < 3 || !std::isfinite(residual)) break;
    for (std::size_t j = 0; j < m; ++j) {
      Block3 first, second;
      difference_jacobians(&v[3 * j], first, second);
      row_a[j] = j == 0 ? Vec3(0.0, 0.0, 0.0) : Vec3(first.row(1));  // the end nodes do not move
      row_b[j] = j + 1 == m ? Vec3(0.0, 0.0, 0.0) : Vec3(second.row(1));
    }
    bool sound = true;
    for (std::size_t j = 0; j < m; ++j) {  // L D Lᵀ of C M⁻¹ Cᵀ, tridiagonal
      diagonal[j] =
          row_a[j].dot(inverse_mass.cwiseProduct(row_a[j])) + row_b[j].dot(inverse_mass.cwiseProduct(row_b[j])) + 1e-12;
      multiplier[j] = -v[3 * j + 1];
      if (j > 0) {
        const double coupling = row_b[j - 1].dot(inverse_mass.cwiseProduct(row_a[j]));
        off[j - 1] = coupling / diagonal[j - 1];
        diagonal[j] -= off[j - 1] * coupling;
        multiplier[j] -= off[j - 1] * multiplier[j - 1];
      }
      sound = sound && diagonal[j] > 0.0;
    }
    if (!sound) break;
    for (std::size_t j = m; j-- > 0;) {
      multiplier[j] /= diagonal[j];
      if (j + 1 < m) multiplier[j] -= off[j] * multiplier[j + 1];
    }
    std::fill(step.begin(), step.end(), Vec3(0.0, 0.0, 0.0));
    double largest = 0.0;
    for (std::size_t j = 0; j < m; ++j) {
      step[j] += inverse_mass.cwiseProduct(row_a[j]) * multiplier[j];
      step[j + 1] += inverse_mass.cwiseProduct(row_b[j]) * multiplier[j];
    }
    for (const Vec3& s : step) largest = std::max(largest, s.cwiseAbs().maxCoeff());
    const double scale = largest > ROLLING_LARGEST_STEP ? ROLLING_LARGEST_STEP / largest : 1.0;
    for (std::size_t j = 0; j < n; ++j) {
      double pose[3];
      integrate(plane, coordinates + j * nv, step[j].data(), scale, pose);
      std::copy(pose, pose + 3, coordinates + j * nv);
    }
  }
  return residual;
}

}  // namespace strips
