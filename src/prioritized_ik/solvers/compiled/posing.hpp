// Rows of a problem where a robot is, written from MuJoCo's own arrays in one call: Jacobians and errors of points, turns,
// centres of mass and joints, and bounds. posing.py is the form to read; MuJoCo's functions come as addresses.
#pragma once

#include <cstdint>

#include "dense.hpp"

namespace prioritized_ik {

// Everything is Python's, see `_Rows` and `_Asked` in posing.py; arrays in the order of C, matrices (rows, joints).
struct PosedRows {
    int32_t kind, body, count, floored;  // floored: no target below zero
    double gain;
    const double *here, *wanted, *across;  // (3), of turns (9), of joints all positions; across (count, 3) or null
    const double* axes;                    // (9) those that `across` is in, null for the world's
    const int32_t *places, *dofs;          // of joints among the positions, and in dθ
    double *matrix, *target;               // of bounds the lower and upper ones
};

struct Posing {
    int32_t count, joints;
    const void* model;
    void* data;
    void (*jac)(const void*, const void*, double*, double*, const double*, int);
    void (*jac_mass)(const void*, void*, double*, int);
    void (*to_quaternion)(double*, const double*);
    void (*to_vector)(double*, const double*, double);
    const PosedRows* rows;
    double* scratch;  // (6, joints)
};

enum PosedKind : int32_t { POINT, TURN, MASS, JOINTS, BOUNDS };  // of posing.py

class Poser {
  public:
    explicit Poser(const Posing& posing) : p(posing), m(posing.joints), of_mass(p.scratch + 3 * m) {}

    void write() {
        for (int i = 0; i < p.count; i++) {
            const PosedRows& rows = p.rows[i];
            if (rows.kind == BOUNDS) bound(rows);
            else if (rows.kind == JOINTS)
                for (int k = 0; k < rows.count; k++) rows.target[k] = rows.gain * (rows.wanted[k] - rows.here[rows.places[k]]);
            else frame(rows);
        }
    }

  private:
    void frame(const PosedRows& rows) {
        double* jacobian = rows.across ? p.scratch : rows.matrix;
        const double origin[3] = {0.0, 0.0, 0.0};
        if (rows.kind == POINT) p.jac(p.model, p.data, jacobian, nullptr, rows.here, rows.body);
        else if (rows.kind == TURN) p.jac(p.model, p.data, nullptr, jacobian, origin, rows.body);
        else mass(rows.body, jacobian);
        double error[3] = {0.0, 0.0, 0.0};
        if (rows.wanted) {
            if (rows.kind == TURN) turn(rows, error);
            else
                for (int k = 0; k < 3; k++) error[k] = rows.wanted[k] - rows.here[k];
        }
        if (!rows.across) {
            for (int k = 0; k < 3; k++) set(rows, k, error[k]);
            return;
        }
        for (int i = 0; i < rows.count; i++) {
            double side[3];
            for (int k = 0; k < 3; k++) {
                const double *given = rows.across + 3 * i, *axis = rows.axes ? rows.axes + 3 * k : nullptr;
                side[k] = axis ? axis[0] * given[0] + axis[1] * given[1] + axis[2] * given[2] : given[k];
            }
            double* to = rows.matrix + size_t(i) * m;
            for (int j = 0; j < m; j++) to[j] = side[0] * jacobian[j] + side[1] * jacobian[m + j] + side[2] * jacobian[2 * m + j];
            set(rows, i, side[0] * error[0] + side[1] * error[1] + side[2] * error[2]);
        }
    }

    // The Jacobian of a centre of mass, asked for once: MuJoCo goes through all bodies.
    void mass(int body, double* jacobian) {
        if (body != mass_body) p.jac_mass(p.model, p.data, of_mass, mass_body = body);
        copy(of_mass, jacobian, size_t(3) * m);
    }

    void set(const PosedRows& rows, int i, double error) const {
        const double target = rows.gain * error;
        rows.target[i] = rows.floored && target < 0.0 ? 0.0 : target;
    }

    // The vector of the turn from here to what is wanted.
    void turn(const PosedRows& rows, double* vector) const {
        double between[9], quaternion[4];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                const double *there = rows.wanted + 3 * i, *here = rows.here + 3 * j;
                between[3 * i + j] = there[0] * here[0] + there[1] * here[1] + there[2] * here[2];
            }
        p.to_quaternion(quaternion, between);
        p.to_vector(vector, quaternion, 1.0);
    }

    // wanted: low and high ends of the joints' ranges, one after the other; across: how far a step goes down and up.
    void bound(const PosedRows& rows) const {
        for (int i = 0; i < rows.count; i++) {
            const double here = rows.here[rows.places[i]];
            const double down = min(rows.wanted[i] - here, 0.0), up = max(rows.wanted[rows.count + i] - here, 0.0);
            rows.matrix[rows.dofs[i]] = max(down, rows.across[i]);
            rows.target[rows.dofs[i]] = min(up, rows.across[rows.count + i]);
        }
    }

    const Posing& p;
    const int m;
    double* const of_mass;  // (3, joints), of the body whose number follows
    int mass_body = -1;
};

}  // namespace prioritized_ik
