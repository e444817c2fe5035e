// How far a step moves points of a kinematic tree: `PointRows.times` and `sizes_of_terms` of kinematic_tree.py, as they are there.
#pragma once

#include "tree_stages.hpp"

namespace prioritized_ik {

// motions (k) := how far rows move at dtheta (m); sizes (k) := how large the terms are whose sum that is.
inline void motions(const TreeInput& in, const double* dtheta, double* motions, double* sizes) {
    std::vector<double> twists(size_t(TWIST) * in.joints);  // angular, and of the world's origin
    for (int j = 0; j < in.joints; j++) {
        const double* w = in.angular + size_t(3) * j;
        double *t = twists.data() + size_t(TWIST) * j, at_anchor[3];
        cross(w, in.anchors + size_t(3) * j, at_anchor);
        for (int i = 0; i < 3; i++) {
            t[i] = w[i] * dtheta[j];
            t[3 + i] = (in.linear[size_t(3) * j + i] - at_anchor[i]) * dtheta[j];
        }
        if (in.parents[j] >= 0)
            for (int i = 0; i < TWIST; i++) t[i] += twists[size_t(TWIST) * in.parents[j] + i];
    }
    for (int row = 0; row < in.rows; row++) {
        motions[row] = sizes[row] = 0.0;
        if (in.row_joints[row] < 0) continue;
        const double *t = twists.data() + size_t(TWIST) * in.row_joints[row], *n = in.directions + size_t(3) * row;
        double moment[3];
        cross(in.points + size_t(3) * row, n, moment);
        double along = 0.0, about = 0.0, of_along = 0.0, of_about = 0.0;
        for (int i = 0; i < 3; i++) {
            along += n[i] * t[3 + i], of_along += abs(n[i] * t[3 + i]);
            about += moment[i] * t[i], of_about += abs(moment[i] * t[i]);
        }
        motions[row] = along + about;
        sizes[row] = of_along + of_about;
    }
}

}  // namespace prioritized_ik
