// A winding controller's look at its arm, and the numbers of the problem it poses there: winding/controller.py in one call
// each. What is computed stands in touch.py, winding/plan.py, jacobians.py and limits.py; here it is read from MuJoCo's own
// arrays, and MuJoCo's functions come as addresses.
#pragma once

#include <cstdint>

#include "dense.hpp"
#include "vectors.hpp"

namespace prioritized_ik {

// Everything is Python's, see `Scene` in winding/compiled.py: n links, m joints, nq positions; arrays in the order of C.
struct Scene {
    int32_t links, joints, positions, object, ranges;
    double reach, contact_distance, release_distance, stride, dead_band, margin, min_distance, gain, max_step, outside, largest;
    double cylinder_radius, cylinder_half_height, askew;
    const void* model;
    void* data;
    void (*kinematics)(const void*, void*);
    void (*com_pos)(const void*, void*);
    double (*geom_distance)(const void*, void*, int, int, double, double*);
    // of the model, by link
    const int32_t *geoms, *bodies, *roots, *end_bodies, *end_roots, *range_dofs, *range_places;
    const uint8_t *moves, *end_moves;
    const double *offsets, *half_lengths, *radii, *spheres, *box, *range_low, *range_high;
    // of the state
    double* qpos;
    const double *xpos, *xmat, *geom_xpos, *geom_xmat, *cdof, *subtree_com;
    // what is given: positions, which links were in contact
    const double* q;
    const uint8_t* was_in_contact;
    // what is seen
    double *end_points, *directions, *distance, *normal, *point, *contact_vectors, *desired, *signs;
    uint8_t* in_contact;
    int32_t* ends;  // the first and the last link in contact
    double* axes;  // room
};

// Where the numbers of a problem go; null for what it does not have. `places` has the first row of J of each arm, -1 for none.
// Every link has a contact row; those of links that are far have an infinite side.
struct Numbers {
    double *matrix, *target, *lower, *upper, *row_matrix, *row_upper;
    const int32_t* places;
};

class Look {
  public:
    enum Answer { DONE = 0, REFUSED = -1 };  // positions that are not finite, or outside their range: Python says which

    explicit Look(const Scene& scene) : s(scene), n(scene.links), m(scene.joints) {}

    // The situation at q, as WindingController.observe.
    int observe() const {
        if (!set_positions()) return REFUSED;
        for (int i = 0; i < n; i++) touch(i);
        for (int i = 0; i < n; i++) {
            const double limit = s.was_in_contact[i] ? s.release_distance : s.contact_distance;
            s.in_contact[i] = s.distance[i] <= limit;
            for (int k = 0; k < 3; k++) {
                s.contact_vectors[3 * i + k] = s.in_contact[i] ? s.normal[3 * i + k] : 0.0;
                s.directions[3 * i + k] = s.xmat[9 * s.bodies[i] + 3 * k];
            }
            const double *turn = s.xmat + 9 * s.end_bodies[i], *place = s.xpos + 3 * s.end_bodies[i];
            for (int k = 0; k < 3; k++) s.end_points[3 * i + k] = place[k] + dot3(turn + 3 * k, s.offsets + 3 * i);
        }
        for (int i = 0; i < n; i++) plan(i);
        find_ends();
        return DONE;
    }

    // Jacobian, contact rows and bounds at the state that was observed, as WindingController.problem.
    int pose(const Numbers& to) const {
        if (to.lower && !bound(to.lower, to.upper)) return REFUSED;
        for (int j = 0; j < m; j++)
            for (int k = 0; k < 6; k++) s.axes[k * m + j] = s.cdof[6 * j + k];
        for (int i = 0; i < n; i++) {
            if (to.places[i] < 0) continue;
            stack(i, to.matrix + size_t(to.places[i]) * m);
            copy(s.desired + 3 * i, to.target + to.places[i], 3);
        }
        for (int i = 0; to.row_matrix && i < n; i++) {
            double* row = to.row_matrix + size_t(i) * m;
            const bool is_near = s.distance[i] < s.margin;
            if (is_near) approach(i, row);
            else std::fill_n(row, m, 0.0);
            to.row_upper[i] = is_near ? s.gain * max(s.distance[i] - s.min_distance, 0.0) : INFINITE;
        }
        return DONE;
    }

  private:
    bool set_positions() const {
        for (int i = 0; i < s.positions; i++)
            if (!(abs(s.q[i]) <= s.largest)) return false;
        copy(s.q, s.qpos, s.positions);
        s.kinematics(s.model, s.data);
        s.com_pos(s.model, s.data);
        return true;
    }

    // Whether the sphere around a link is out of reach of the box around the object, so that nothing is to be measured.
    bool is_far(int i) const {
        constexpr double SURE = 1e-4;  // [m] more than MuJoCo's distances may be off
        const double *link = s.geom_xpos + 3 * s.geoms[i], *place = s.geom_xpos + 3 * s.object, *turn = s.geom_xmat + 9 * s.object;
        double square = 0.0;
        for (int k = 0; k < 3; k++) {
            double along = -s.box[k];
            for (int j = 0; j < 3; j++) along += turn[3 * j + k] * (link[j] - place[j]);
            const double gap = max(abs(along) - s.box[3 + k], 0.0);
            square += gap * gap;
        }
        return sqrt(square) > s.spheres[i] + s.reach + SURE;
    }

    // Whether the object is a cylinder and link i beside it, and if so, its distance and nearest point, as in TouchSensor.
    bool beside_cylinder(int i, double* point) const {
        const double *link = s.geom_xpos + 3 * s.geoms[i], *axis = s.geom_xmat + 9 * s.geoms[i] + 2;
        const double *place = s.geom_xpos + 3 * s.object, *turn = s.geom_xmat + 9 * s.object;
        const double half_length = s.half_lengths[i];
        double start[3], direction[3], core[3];
        for (int k = 0; k < 3; k++) {
            start[k] = direction[k] = 0.0;
            for (int j = 0; j < 3; j++) {
                start[k] += turn[3 * j + k] * (link[j] - place[j]);
                direction[k] += turn[3 * j + k] * axis[3 * j];
            }
        }
        const double askew = direction[0] * direction[0] + direction[1] * direction[1];
        const double nearest = -(start[0] * direction[0] + start[1] * direction[1]) / max(askew, s.askew);
        const double along = min(max(nearest, -half_length), half_length);
        for (int k = 0; k < 3; k++) core[k] = start[k] + along * direction[k];
        const double off_axis = sqrt(core[0] * core[0] + core[1] * core[1]);
        const bool is_unique = askew >= s.askew || half_length == 0.0;
        if (!(is_unique && abs(core[2]) <= s.cylinder_half_height && off_axis > s.cylinder_radius)) return false;
        s.distance[i] = min(off_axis - s.cylinder_radius - s.radii[i], s.reach);
        const double inwards = s.radii[i] / off_axis;
        for (int k = 0; k < 3; k++) {
            const double outward = turn[3 * k] * core[0] + turn[3 * k + 1] * core[1];
            point[k] = link[k] + along * axis[3 * k] - inwards * outward;
        }
        return true;
    }

    // As TouchSensor.read.
    void touch(int i) const {
        double segment[6], *point = s.point + 3 * i, *normal = s.normal + 3 * i, axis[3], inward[3];
        s.distance[i] = s.reach;
        if (!beside_cylinder(i, segment)) {
            if (is_far(i)) clear(segment, 6);  // as MuJoCo does
            else s.distance[i] = s.geom_distance(s.model, s.data, s.geoms[i], s.object, s.reach, segment);
        }
        copy(segment, point, 3);
        const double *centre = s.geom_xpos + 3 * s.geoms[i], *turn = s.geom_xmat + 9 * s.geoms[i];
        double along = 0.0;
        for (int k = 0; k < 3; k++) {
            axis[k] = turn[3 * k + 2];
            along += (point[k] - centre[k]) * axis[k];
        }
        along = min(max(along, -s.half_lengths[i]), s.half_lengths[i]);
        for (int k = 0; k < 3; k++) inward[k] = centre[k] + along * axis[k] - point[k];
        const double size = s.distance[i] >= s.reach ? INFINITE : sqrt(dot3(inward, inward));
        for (int k = 0; k < 3; k++) normal[k] = inward[k] / size;
    }

    // Eqs. (18) to (22) of link i, as plan.plan_arm.
    void plan(int i) const {
        double *desired = s.desired + 3 * i, normal[3], towards[3];
        std::fill_n(desired, 3, 0.0);
        s.signs[i] = 0.0;
        if (!i) return;
        const double* direction = s.directions + 3 * i;
        cross(direction - 3, s.contact_vectors + 3 * i - 3, normal);
        const double out_of_plane = dot3(direction, normal);
        s.signs[i] = abs(out_of_plane) <= s.dead_band ? 0.0 : out_of_plane > 0.0 ? -1.0 : 1.0;
        if (!s.in_contact[i - 1] || s.in_contact[i]) return;
        cross(direction, normal, towards);
        for (int k = 0; k < 3; k++) desired[k] = s.stride * (s.signs[i] * normal[k] + towards[k]);
    }

    void find_ends() const {
        int first = 0;
        while (first < n && !s.in_contact[first]) first++;
        int last = first;
        while (last < n && s.in_contact[last]) last++;
        s.ends[0] = first < n ? first + 1 : 0;
        s.ends[1] = first < n ? last : 0;
    }

    bool bound(double* lower, double* upper) const {
        std::fill_n(lower, m, -s.max_step);
        std::fill_n(upper, m, s.max_step);
        for (int r = 0; r < s.ranges; r++) {
            const int dof = s.range_dofs[r];
            const double here = s.q[s.range_places[r]], down = s.range_low[r] - here, up = s.range_high[r] - here;
            if (down > s.outside || up < -s.outside) return false;
            lower[dof] = max(min(down, 0.0), -s.max_step);
            upper[dof] = min(max(up, 0.0), s.max_step);
        }
        return true;
    }

    // Rows of J of one end point, v + ω x r, as PointJacobians.at.
    void stack(int i, double* x) const {
        const double* com = s.subtree_com + 3 * s.end_roots[i];
        double r[3], *y = x + m, *z = y + m;
        for (int k = 0; k < 3; k++) r[k] = s.end_points[3 * i + k] - com[k];
        const double *wx = s.axes, *wy = wx + m, *wz = wy + m, *vx = wz + m, *vy = vx + m, *vz = vy + m;
        const uint8_t* moves = s.end_moves + size_t(i) * m;
        for (int j = 0; j < m; j++) {
            const bool still = !moves[j];
            x[j] = still ? 0.0 : wy[j] * r[2] - wz[j] * r[1] + vx[j];
            y[j] = still ? 0.0 : wz[j] * r[0] - wx[j] * r[2] + vy[j];
            z[j] = still ? 0.0 : wx[j] * r[1] - wy[j] * r[0] + vz[j];
        }
    }

    // -n·J of the nearest point on link i, n its normal, as in limits.contact_rows for an object that does not move.
    void approach(int i, double* row) const {
        const double *com = s.subtree_com + 3 * s.roots[i], *normal = s.normal + 3 * i;
        double lever[3], moment[3];
        for (int k = 0; k < 3; k++) lever[k] = s.point[3 * i + k] - com[k];
        cross(lever, normal, moment);  // n·(ω x r) = ω·(r x n)
        const double *wx = s.axes, *wy = wx + m, *wz = wy + m, *vx = wz + m, *vy = vx + m, *vz = vy + m;
        const uint8_t* moves = s.moves + size_t(i) * m;
        for (int j = 0; j < m; j++) {
            const double turned = wx[j] * moment[0] + wy[j] * moment[1] + wz[j] * moment[2];
            row[j] = moves[j] ? -(turned + (vx[j] * normal[0] + vy[j] * normal[1] + vz[j] * normal[2])) : 0.0;
        }
    }

    const Scene& s;
    const int n, m;
};

}  // namespace prioritized_ik
