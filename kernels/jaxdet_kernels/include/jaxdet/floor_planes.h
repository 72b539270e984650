// Floor planes, and their refinement by least squares, in integers. Twin of
// jaxdet/reference/_floor_planes.py, which documents the method and the constants.
#pragma once
#include "warp.h"

namespace jaxdet { namespace {

// Tolerance of inliers at depth 0 [depth units], and its increase per depth unit of z, with
// FloorSlack::BITS fraction bits.
struct FloorTolerance {
    int base, per_z;
};

// Settings in the order of `_floor_settings` in jaxdet/stages/_tables.py, which documents them. Lengths
// are in depth units.
struct FloorSettings {
    int stride, max_depth, noise;
    FloorTolerance rough, fine, sharp;
    int wide_per_z, lever_bits, bin_bits, span, edge, lowest, highest, rings[6];
    int max_turn, max_shift, min_share, min_share_alone, table, deep, over_table, step, ramps;
    int farthest_ramp, run_bits, rise_bits, runs, half, profile_base, ramp_near, spread, start_step;
    int drop_spacing, alike, starts[16];
};

// Plane by the pose of the camera above it: pitch and roll [angle steps] and height [depth units].
struct FloorPlane {
    int pitch, roll, height;

    bool operator==(const FloorPlane& other) const {
        return pitch == other.pitch && roll == other.roll && height == other.height;
    }
};

// Positions of measured cells in the camera optical frame [depth units].
struct FloorCells {
    int *x, *y, *z;
    int count;

    void put(int k, int px, int py, int pz) const { x[k] = px, y[k] = py, z[k] = pz; }
    FloorCells part(int from, int size) const { return {x + from, y + from, z + from, size}; }
};

// Unit vector with DOWN_BITS fraction bits; its product with positions up to 2^18 fits in 32 bits.
struct FloorDirection {
    enum { DOWN_BITS = 12 };
    int x, y, z;

    int along(int px, int py, int pz) const {
        return (x * px + y * py + z * pz + (1 << (DOWN_BITS - 1))) >> DOWN_BITS;
    }
};

// Tolerance of the inliers of a plane, for a height of the camera [depth units]. It is below 1.4 million,
// its value at depth 65535, height 20 m and noise 1 per metre, so nine times its square is below 2^44.
struct FloorSlack {
    enum { BITS = 26 };
    int base;
    long long rate;  // increase per depth unit of z, BITS fraction bits

    FloorSlack(FloorTolerance of, int noise, int height)
        : base(of.base), rate(of.per_z + (long long)noise * (height > 0 ? height : 0)) {}

    // z * rate is below 2^47 because tolerances are below 2^21, so a double is exact.
    int at(int z) const { return base + (int)(z * ((double)rate / (1 << BITS))); }
};

struct FloorAngles {
    enum {
        ANGLES = 32,
        SINE_BITS = 15,
        STEEPEST = 85 * ANGLES,
        RADIAN = 1833,
        SLOPE_BITS = 14
    };
    // Sines with SINE_BITS fraction bits, one per angle step; the first is the sine of -360 degrees.
    const int* sines;

    int sine(int angle) const { return sines[angle + 360 * ANGLES]; }
    int cosine(int angle) const { return sines[angle + 450 * ANGLES]; }

    // Vectors down, right and forward in the camera frame, with `bits` fraction bits.
    FloorDirection down(int pitch, int roll, int bits = FloorDirection::DOWN_BITS) const {
        const int shift = 2 * SINE_BITS - bits, half = 1 << (shift - 1), level = cosine(pitch);
        return {(sine(roll) * level + half) >> shift, (cosine(roll) * level + half) >> shift,
                (sine(pitch) * (1 << SINE_BITS) + half) >> shift};
    }
    FloorDirection right(FloorPlane p, int bits = FloorDirection::DOWN_BITS) const {
        return down(0, p.roll + 90 * ANGLES, bits);
    }
    FloorDirection down(FloorPlane p, int bits = FloorDirection::DOWN_BITS) const {
        return down(p.pitch, p.roll, bits);
    }
    FloorDirection forward(FloorPlane p, int bits = FloorDirection::DOWN_BITS) const {
        return down(p.pitch + 90 * ANGLES, p.roll, bits);
    }

    // Angle wrapped to -180 degrees or more, and less than 180.
    int wrapped(int angle) const {
        const int half = 180 * ANGLES;
        return angle - (int)quotient(angle + half, 2 * half) * 2 * half;
    }

    // Quotient a / b, rounded down; b must be positive.
    long long quotient(long long a, long long b) const {
        const long long whole = a / b;
        return whole - (a < 0 && whole * b != a);
    }

    // Quotient a / b, rounded to the nearest integer, halves up; b must be positive.
    long long rounded(long long a, long long b) const { return quotient(2 * a + b, 2 * b); }

    // Tangent of an angle, with SLOPE_BITS fraction bits.
    int slope(int angle) const {
        return (int)quotient((long long)sine(angle) * (1 << SLOPE_BITS), cosine(angle));
    }

    int clipped(long long value, int most) const {
        return (int)(value > most ? most : value < -most ? -most : value);
    }
};

// Score of a cell for a floor: 1 for an inlier, minus BELOW_COST if it is clearly below the floor.
struct FloorScore {
    enum { BELOW = 4, BELOW_COST = 2 };

    static int of(int below, int slack) {
        const int on = (below <= slack) & (-below <= slack);
        return on - BELOW_COST * (below > BELOW * slack);
    }
};

// Key by which candidates are compared. The best candidate has the smallest key: it has the most votes
// and, among candidates with equal votes, the lowest index.
struct FloorKey {
    typedef unsigned long long Word;

    static Word of(int votes, int number) {
        return (Word)(0x7fffffffu - (unsigned)votes) << 32 | (unsigned)number;
    }
    static int votes(Word key) { return (int)(0x7fffffffu - (unsigned)(key >> 32)); }
    static int number(Word key) { return (int)(unsigned)key; }
};

// Group of threads of a team that share a task: the complete team, or a warp. On the CPU it is a single
// thread.
struct ThreadGroup {
    enum { WARP = Warp::size, MOST_SUMS = 10, MOST_SHARED = 4 };
    const Team* team;
    // For a complete team: two rows of the warps' sums, used alternately. Null if the group is a warp.
    unsigned long long* rows;
    int turn;

    // Makes the group of this thread's warp.
    explicit ThreadGroup(const Team& all) : team(&all), rows(nullptr), turn(0) {}

    // Makes a group of the complete team; `scratch` has words(team) words.
    ThreadGroup(const Team& all, unsigned long long* scratch) : team(&all), rows(scratch), turn(0) {}

    static int words(const Team& all) {
        return 2 * 2 * MOST_SUMS * ((all.size + WARP - 1) / WARP) + MOST_SHARED;
    }

    // index, count  index of this group in the team, and number of groups
    // leads         whether this thread is in the first warp, which does work for the complete team that
    //               would be the same in all warps
    // broadcast     sends results of the first warp to the other threads, at most MOST_SHARED values;
    //               between any two calls there must be a sum
    // sum           replaces each of at most MOST_SUMS values by its sum over the group; a collective call
    int rank() const { return rows ? team->rank : team->rank % WARP; }
    int size() const { return rows ? team->size : (int)WARP; }
    int index() const { return rows ? 0 : team->rank / WARP; }
    int count() const { return rows ? 1 : team->size / WARP; }
    bool leads() const { return rank() < WARP; }
#if defined(__CUDA_ARCH__)
    void broadcast(int* values, int n) const {
        if (!rows) return;
        volatile int* shared = (volatile int*)(rows + 2 * MOST_SUMS * (team->size / WARP));
        if (team->rank == 0)
            for (int k = 0; k < n; k++) shared[k] = values[k];
        team->sync();
        for (int k = 0; k < n; k++) values[k] = shared[k];
    }
    // A thread that fills a row has passed the sync of the previous sum, which all readers of that row
    // reached after reading it.
    void sum(long long* values, int n) {
        const Warp warp(*team);
        for (int k = 0; k < n; k++) values[k] = warp.sum(values[k]);
        if (!rows) return;
        const int warps = team->size / WARP, lane = team->rank % WARP;
        unsigned long long* row = rows + turn * warps * MOST_SUMS;
        turn ^= 1;
        if (lane == 0)
            for (int k = 0; k < n; k++) row[team->rank / WARP * MOST_SUMS + k] = values[k];
        team->sync();
        long long total = 0;
        if (lane < n)
            for (int k = 0; k < warps; k++) total += row[k * MOST_SUMS + lane];
        for (int k = 0; k < n; k++) values[k] = __shfl_sync(0xffffffffu, total, k);
    }
#else
    void broadcast(int*, int) const {}
    void sum(long long*, int) {}
#endif
};

struct FloorRefine {
    enum { LARGEST_TURN = 8 * FloorAngles::ANGLES, TURN_BITS = 24, RIDGE = 14, FEWEST = 20 };
    FloorAngles angles;
    const FloorSettings* settings;
    // Prior of the angles, if `is_given`. It is a copy, because a value whose address is taken would
    // be kept in memory instead of registers.
    FloorPlane prior;
    bool is_given;
    // Scratch, one word per cell, private to the group.
    int* weights;

    // Refines a plane: at most `rough` rounds with the rough tolerance, then at most `fine` rounds with
    // the fine one, then at most `sharp` rounds with the sharp one. Returns the refined plane.
    FloorPlane run(ThreadGroup& group, FloorPlane plane, const FloorCells& cells, int rough, int fine,
                   int sharp) const {
        // There is a single loop, so that `round` is inlined only once.
        for (int k = 0, n = 0; k < 3;) {
            const FloorTolerance near = k == 0   ? settings->rough
                                        : k == 1 ? settings->fine
                                                 : settings->sharp;
            const int rounds = k == 0 ? rough : k == 1 ? fine : sharp;
            const FloorPlane before = plane;
            // A round that changes nothing has converged.
            const bool more = n < rounds && round(group, plane, cells, near) && !(plane == before);
            n = more ? n + 1 : 0;
            k += !more;
        }
        return plane;
    }

    // Divides integers by a fixed divisor and rounds down. The dividends must not be negative, and the
    // quotients must be at most 64.
    struct Quotients {
        // The result is exact for divisors below 2^44: (n + 1/2) / divisor is at least 2^-45 away from
        // any integer, and the rounding error of the product is at most 2^-46.
        double inverse;
        explicit Quotients(double divisor) : inverse(1.0 / divisor) {}
        int of(double n) const { return (int)((n + 0.5) * inverse); }
    };

    // Refines the plane by one round of weighted least squares. Returns false, with the plane
    // unchanged, if fewer than FEWEST cells are near the plane or if all weights are 0.
    bool round(ThreadGroup& group, FloorPlane& plane, const FloorCells& cells,
               FloorTolerance tolerance) const {
        const FloorDirection down = angles.down(plane);
        const FloorDirection right = angles.right(plane), forward = angles.forward(plane);
        const FloorSlack slack(tolerance, settings->noise, plane.height);
        const int height = plane.height, lever = settings->lever_bits;
        const double squares = 64 * 9 * (double)slack.base * slack.base;
        const int *__restrict__ xs = cells.x, *__restrict__ ys = cells.y, *__restrict__ zs = cells.z;
        int* __restrict__ out = weights;
        const int first = group.rank(), step = group.size(), last = cells.count;
        int count = 0, w0 = 0;
        long long we = 0, wt = 0, ws = 0, tt = 0, ts = 0, ss = 0, te = 0, se = 0;
        for (int i = first; i < last; i += step) {
            const int x = xs[i], y = ys[i], z = zs[i];
            const int off = down.along(x, y, z) - height, allowed = slack.at(z);
            const bool near = 2 * off <= 3 * allowed && -2 * off <= 3 * allowed;
            const int e = near ? off : 0;
            const Quotients by_gate(9 * (double)allowed * allowed);
            const int taper = 64 - by_gate.of(256 * (double)e * e);
            const int part = by_gate.of(squares) + 1;
            // The weight is at most 4160, so that its products with distances fit in 32 bits.
            const int w = near ? taper * taper * part >> 6 : 0;
            const int t = forward.along(x, y, z) >> lever, s = right.along(x, y, z) >> lever;
            out[i] = w;
            const int at = w * t, as = w * s;
            count += near;
            w0 += w;
            we += (long long)w * e;
            wt += at;
            ws += as;
            tt += (long long)at * t;
            ts += (long long)at * s;
            ss += (long long)as * s;
            te += (long long)at * e;
            se += (long long)as * e;
        }
        long long sums[10] = {count, w0, we, wt, ws, tt, ts, ss, te, se};
        group.sum(sums, 10);
        if (sums[0] < FEWEST || !sums[1]) return false;
        int turned_to[2] = {0, 0};
        if (group.leads()) turn(sums, plane, turned_to);
        group.broadcast(turned_to, 2);
        plane.pitch = turned_to[0];
        plane.roll = turned_to[1];
        const FloorDirection turned = angles.down(plane);
        long long total[1] = {0}, high = 0;
        for (int i = first; i < last; i += step)
            high += (long long)out[i] * turned.along(xs[i], ys[i], zs[i]);
        total[0] = high;
        group.sum(total, 1);
        plane.height = (int)angles.rounded(total[0], sums[1]);
        return true;
    }

    // Writes pitch and roll of the plane after a round [angle steps] to out[0] and out[1]. `sums` has
    // the elements of `sums` in `round`. The rotations about the right and the forward axis are computed
    // by Cramer's rule. The sum of w (a - m_a) (b - m_b), where m_a and m_b are the rounded means, is
    // computed as sum w a b - m_a sum w b - m_b sum w a + m_a m_b sum w.
    void turn(const long long* sums, FloorPlane plane, int* out) const {
        const long long total = sums[1], we = sums[2], wt = sums[3], ws = sums[4];
        const long long e = angles.rounded(we, total), t = angles.rounded(wt, total);
        const long long s = angles.rounded(ws, total);
        const int lever = settings->lever_bits;
        const long long ridge = total * RIDGE;
        long long tt = sums[5] - 2 * t * wt + t * t * total + ridge;
        long long ts = sums[6] - t * ws - s * wt + t * s * total;
        long long ss = sums[7] - 2 * s * ws + s * s * total + ridge;
        long long te = sums[8] - t * we - e * wt + t * e * total;
        long long se = sums[9] - s * we - e * ws + s * e * total;
        const long long one = 1 << FloorAngles::SINE_BITS;
        long long ahead = 0, aside = 0;
        if (is_given) {
            const long long across = angles.wrapped(prior.roll - plane.roll);
            ahead = prior.pitch - plane.pitch;
            aside = angles.rounded(across * angles.cosine(plane.pitch), one);
        }
        te -= angles.rounded(ridge * (ahead * (1 << lever)), FloorAngles::RADIAN);
        se -= angles.rounded(ridge * (aside * (1 << lever)), FloorAngles::RADIAN);
        long long largest = tt > ss ? tt : ss;
        largest = te > largest ? te : -te > largest ? -te : largest;
        largest = se > largest ? se : -se > largest ? -se : largest;
        int shift = 0;
        while (largest >> shift >= 1 << TURN_BITS) shift++;
        tt >>= shift;
        ts >>= shift;
        ss >>= shift;
        te >>= shift;
        se >>= shift;
        long long det = tt * ss - ts * ts;
        det = (det > 1 ? det : 1) << lever;
        const int r = FloorAngles::RADIAN;
        const int pitch = angles.clipped(angles.rounded((se * ts - te * ss) * r, det), LARGEST_TURN);
        const int side = angles.clipped(angles.rounded((te * ts - se * tt) * r, det), LARGEST_TURN);
        const int roll = plane.roll + (int)angles.rounded(side * one, angles.cosine(plane.pitch));
        out[0] = angles.clipped(plane.pitch + pitch, FloorAngles::STEEPEST);
        out[1] = angles.wrapped(roll);
    }
};

} }  // namespace jaxdet
