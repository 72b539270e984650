// How far the floor is free along fixed bearings from the camera's foot. Twin of
// jaxdet/reference/_rays.py.
#pragma once
#include "cells.h"
#include "floor_frame.h"
#include "grid.h"

namespace jaxdet { namespace {

struct Rays {
    enum {
        RAYS = 1440,
        UNIT_BITS = 4,
        UNITS = 1 << UNIT_BITS,  // of a bearing, between neighbouring rays
        TURN = RAYS * UNITS,
        RATIO_BITS = 12,
        BITS = 13,       // fraction bits of a direction
        TURN_BITS = 13,  // and of a small turn
        MOST_WIDER = 8,  // times that a column is wider at its end than at its neighbour's
        END_BITS = 2,
        NONE = 0x7fffffff
    };
    enum { UNKNOWN, OBSTACLE };  // as in FreeFloor
    struct Point { int right, forward; };

    const Team& team;
    int columns;
    const int* angles;       // (2^RATIO_BITS + 1,) of bearings up to an eighth of a turn, by tangent
    const int* directions;   // (2, RAYS, 2): of the rays, and of the left edges of their sectors
    const int *line, *ends;  // (columns, 2, 2), (columns,): where columns begin and end, and why
    // By ray: where the floor begins; packed, where it ends; what stands before that; and the nearest
    // of the obstacles that columns show.
    int *start, *stop, *block, *only;
    int half;  // of a cell, with four more bits
    int turn;  // the same in radians, with TURN_BITS

    // The quotient rounded down; the divisor is positive.
    static long long floored(long long a, long long b) {
        const long long all = a / b;
        return all - (all * b > a);
    }
    static int magnitude(int a) { return a < 0 ? -a : a; }

    // The quotient of integers from 0 on rounded down, below 2^31. Float64 tells such quotients from
    // the next whole number, and CPUs divide several at once.
    static int quotient(unsigned a, unsigned b) {
#if defined(__CUDA_ARCH__)
        return (int)(a / b);
#else
        return (int)((double)a / (double)b);
#endif
    }

    // Clockwise from above, 0 ahead.
    __attribute__((always_inline)) int bearing(int right, int forward) const {
        const int aside = magnitude(right), ahead = magnitude(forward);
        const int low = aside < ahead ? aside : ahead, high = aside < ahead ? ahead : aside;
        int angle = angles[quotient((unsigned)low << RATIO_BITS, (unsigned)(high ? high : 1))];
        angle = aside > ahead ? TURN / 4 - angle : angle;
        angle = forward < 0 ? TURN / 2 - angle : angle;
        return right < 0 ? -angle : angle;
    }
    int bearing(Point p) const { return bearing(p.right, p.forward); }

    // Counted on from 0 without an end.
    static int sector(int bearing) { return (bearing + TURN / 2 + UNITS / 2) >> UNIT_BITS; }
    static int wrapped(int sector) {
        return sector < 0 ? sector + RAYS : sector < RAYS ? sector : sector - RAYS;
    }

    // The distance from the foot along the ray of a bearing; below 2^53 float64 is exact.
    __attribute__((always_inline)) int range(int right, int forward, int bearing) const {
        const int* const way = directions + 2 * wrapped(sector(bearing));
        const double sum = (double)right * way[0] + (double)forward * way[1] + (1 << (BITS - 1));
        return (int)((sum < 0 ? -sum : sum) * (1.0 / (1 << BITS)));
    }
    int range(Point p, int bearing) const { return range(p.right, p.forward, bearing); }

    // Of equal ranges an obstacle is least, then a drop.
    static int packed(int range, int why) { return range << END_BITS | ((why - 1) & 3); }

    void begin() const {
        for (int i = team.rank; i < RAYS; i += team.size) {
            start[i] = -1;
            stop[i] = block[i] = only[i] = NONE;
        }
        team.sync();
    }

    Point near(int c) const { return {line[4 * c], line[4 * c + 1]}; }
    Point far(int c) const { return {line[4 * c + 2], line[4 * c + 3]}; }

    // Whether a column shows floor, not only an obstacle.
    bool is_seen(int c) const {
        if (c < 0 || c >= columns) return false;
        const Point a = near(c), b = far(c);
        const bool any = a.right || a.forward || b.right || b.forward;
        return any && !(a.right == b.right && a.forward == b.forward && ends[c] == OBSTACLE);
    }

    // Whether the floor of a column goes from behind the foot to before it, and where it passes.
    bool passes(int c, long long* beside) const {
        if (!is_seen(c)) return false;
        const Point a = near(c), b = far(c);
        if (a.forward > 0 || b.forward < 0 || b.forward <= a.forward) return false;
        const long long across = (long long)(b.right - a.right) * -a.forward;
        *beside = a.right + floored(across, b.forward - a.forward);
        return true;
    }

    bool is_foot_inside() const {
        bool found = false;
        for (int c = team.rank; c + 1 < columns; c += team.size) {
            long long one = 0, other = 0;
            if (!passes(c, &one) || !passes(c + 1, &other)) continue;
            found |= (one < other ? one : other) <= 0 && (one < other ? other : one) >= 0;
        }
        return team.any(found);
    }

    // The sectors that a segment passes, with its least or largest range in each.
    template <bool LEAST, class Put> void sweep(Point first, Point last, Put put) const {
        const int at = bearing(first), to = bearing(last);
        int turn = (to - at + TURN + TURN / 2) % TURN - TURN / 2;
        const int range_first = range(first, at), range_last = range(last, to);
        const bool back = turn < 0;
        const int low = back ? to : at;
        turn = back ? -turn : turn;
        const int left_end = back ? range_last : range_first;
        const int right_end = back ? range_first : range_last;
        const int begin = sector(low), end = sector(low + turn);
        const int x = last.right - first.right, y = last.forward - first.forward;
        const long long cross = (long long)first.right * y - (long long)first.forward * x;
        const long long area = (cross < 0 ? -cross : cross) << BITS;
        const int lowest = range_first < range_last ? range_first : range_last;
        const int highest = range_first < range_last ? range_last : range_first;
        int left = left_end;
        for (int s = begin; s <= end; ++s) {
            int right = right_end;
            if (s < end) {
                const int* const edge = directions + 2 * (RAYS + wrapped(s + 1));
                const long long over = (long long)edge[0] * y - (long long)edge[1] * x;
                const long long all = area / (over ? over < 0 ? -over : over : 1);
                right = all < lowest ? lowest : all > highest ? highest : (int)all;
            }
            put(wrapped(s), LEAST == (left < right) ? left : right);
            left = right;
        }
    }

    void end_at(Point first, Point last, int why) const {
        sweep<true>(first, last, [&](int ray, int range) {
            team.atomic_min(stop + ray, packed(range, why));
        });
    }

    void begin_at(Point first, Point last, bool foot_inside) const {
        if (foot_inside)
            end_at(first, last, UNKNOWN);
        else
            sweep<false>(first, last, [&](int ray, int range) {
                team.atomic_max(start + ray, range);
            });
    }

    // Clockwise about the foot by a small angle.
    static Point turned(Point p, int by) {
        return {p.right + (int)((long long)p.forward * by >> TURN_BITS),
                p.forward + (int)((long long)p.right * -by >> TURN_BITS)};
    }

    // A side of a column whose neighbour shows no floor.
    void add_side(int c, int by, bool foot_inside) const {
        const Point begin = turned(near(c), by), end = turned(far(c), by);
        begin_at(near(c), begin, foot_inside);
        end_at(far(c), end, ends[c]);
        end_at(end, begin, UNKNOWN);
    }

    // Between a column and the next one: from the end of the shorter one halfway to the longer one,
    // along there, and on to the end of the longer one.
    void add_between(int c) const {
        const bool nearer = far(c).forward <= far(c + 1).forward;
        const int brief = nearer ? c : c + 1, lasting = nearer ? c + 1 : c;
        const Point a = near(lasting), b = far(lasting), first = far(brief);
        const int run = b.forward - a.forward, most = run > 0 ? run : 0;
        int part = first.forward - a.forward;
        part = part < 0 ? 0 : part > most ? most : part;
        const int divisor = run > 1 ? run : 1;
        const Point beside = {
            a.right + (int)floored((long long)(b.right - a.right) * part, divisor),
            a.forward + (int)floored((long long)(b.forward - a.forward) * part, divisor)};
        const Point middle = {(first.right + beside.right) >> 1,
                              (first.forward + beside.forward) >> 1};
        const bool wider = beside.forward > 0 && b.forward > beside.forward;
        const long long widest = (long long)MOST_WIDER * beside.forward;
        const long long times = !wider ? 1 : b.forward < widest ? b.forward : widest;
        const int over = wider ? beside.forward : 1;
        const Point last = {b.right + (int)floored((middle.right - beside.right) * times, over),
                            b.forward + (int)floored((middle.forward - beside.forward) * times, over)};
        const int why = ends[brief];
        end_at(first, middle, why);
        end_at(middle, last, why == OBSTACLE ? (int)UNKNOWN : why);
        end_at(last, b, ends[lasting]);
    }

    // The polygon of floor that columns show; ends in a sync.
    void add_floor(bool foot_inside) const {
        for (int c = team.rank; c < columns; c += team.size) {
            if (!is_seen(c)) continue;
            if (!is_seen(c - 1)) add_side(c, -turn, foot_inside);
            if (!is_seen(c + 1)) {
                add_side(c, turn, foot_inside);
                continue;
            }
            begin_at(near(c), near(c + 1), foot_inside);
            add_between(c);
        }
        team.sync();
    }

    // Half of the angle of a cell that is so deep and far.
    __attribute__((always_inline)) int half_angle(int depth, int length) const {
        const int most = TURN / 2 - UNITS;
        const int wide = quotient((unsigned)depth * (unsigned)half, (unsigned)length << 4) + 1;
        return wide < most ? wide : most;
    }

    // Puts a point into the sectors that it stands in.
    void add(int* nearest, Point p, int depth) const {
        const int at = bearing(p), away = range(p, at), length = away > 1 ? away : 1;
        const int wide = half_angle(depth, length), end = sector(at + wide);
        for (int s = sector(at - wide); s <= end; ++s) {
            const int ray = wrapped(s);
            if (length < nearest[ray]) team.atomic_min(nearest + ray, length);
        }
    }

    // Where the floor that columns show on a ray ends, 0 where they show none.
    int floor_end(int ray, bool foot_inside) const {
        return (foot_inside || start[ray] >= 0) && stop[ray] < NONE ? stop[ray] >> END_BITS : 0;
    }

    // The result, all threads after a sync; ends in one. `free_out` (RAYS, 2), `end_out` (RAYS,).
    void put(bool foot_inside, int* free_out, int* end_out) const {
        for (int i = team.rank; i < RAYS; i += team.size) {
            const bool blocks = block[i] < floor_end(i, foot_inside);
            const int least = blocks ? packed(block[i], OBSTACLE) : (int)NONE;
            const int last = stop[i] < least ? stop[i] : least, from = foot_inside ? 0 : start[i];
            const bool free = from >= 0 && last < NONE && from < last >> END_BITS;
            const int before = blocks && block[i] < only[i] ? block[i] : only[i];
            const bool stands = before < NONE;
            free_out[2 * i] = free ? from : stands ? before : 0;
            free_out[2 * i + 1] = free ? last >> END_BITS : stands ? before : 0;
            end_out[i] = free ? (last + 1) & 3 : stands ? (int)OBSTACLE : (int)UNKNOWN;
        }
        team.sync();
    }
};

// What stands above the step: of each cell its nearest pixel or itself.
struct RayBlocks {
    enum { SLOPE_BITS = 14, SAMPLES = 3, WIDEST = Rays::TURN / 16 };
    // As in FreeFloor's settings.
    int nearest, farthest, highest, slope;
    int rows, columns;
    const FloorFrame frame;
    const unsigned char* low;
    const int *pixels, *z, *right, *forward, *height;
    const int *rays, *rises;  // (2, rows, columns); by depth, of a pixel
    const int* obstacles;     // (columns,) cells, -1 = none
    // Scratch, by column: the farthest end of floor in its sectors, and factors of a cell's rays and
    // of 1 that give how far along the middle one of these it is, for a depth of 1.
    float *limit, *way_x, *way_y, *way_z;

    static int higher(int a, int b) { return a > b ? a : b; }

    // Whether the nearest pixel of cell k is in range and above the step of a pixel.
    bool stands(int k) const {
        const int d = pixels[k];
        if (d < nearest || d > farthest) return false;
        const Rays::Point at = ray(k, d);
        int high = frame.level(at.right, at.forward, d);
        if (frame.has_ramp()) high -= frame.rise(frame.forward(at.right, at.forward, d));
        return high > higher(rises[d], d * slope >> SLOPE_BITS) && (high <= highest || !frame.valid);
    }

    // Right and down in the camera.
    Rays::Point ray(int k, int d) const {
        return {CellGrid::along(rays[k], d), CellGrid::along(rays[rows * columns + k], d)};
    }

    enum { NO, IS_CELL, MAY_STAND };
    // Whether cell k ends rays, or perhaps a pixel of it does, before the end of floor in the sectors
    // of column c. In float32, a little too often: what is left out here changes nothing.
    __attribute__((always_inline)) int kind(int k, int c, float step, float floor, bool ramp) const {
        const int d = pixels[k], own = z[k], high = height[k];
        const bool cell = (own >= nearest) & (own <= farthest) & !low[k] & (high <= highest);
        const int depth = d < nearest ? own : d;
        const float away = (way_x[c] * (float)rays[k] + way_y[c] * (float)rays[rows * columns + k] +
                            way_z[c]) * (float)depth;
        // What a pixel is above its cell, from the rays' slope.
        const float above = (floor - (float)high) * (float)(own - d);
        const bool may = (d > 0) & ((own == 0) | (((float)own * (step - (float)high) < above) | ramp));
        return away < limit[c] ? cell ? (int)IS_CELL : may ? (int)MAY_STAND : (int)NO : (int)NO;
    }

    // The farthest end of floor in the sectors that the cells of a column see; a column that looks
    // past the foot sees all.
    void find_limit(int c, const Rays& to, bool foot_inside) const {
        int low_end = 0, high_end = 0, first = 0, half = 0;
        bool wide = false;
        for (int i = 0; i < SAMPLES; ++i) {
            const int k = (rows - 1) * i / (SAMPLES - 1) * columns + c, d = 1 << 12;
            const int x = CellGrid::along(rays[k], d);
            const int y = CellGrid::along(rays[rows * columns + k], d);
            const Rays::Point p = {frame.right(x, y, d), frame.forward(x, y, d)};
            const int at = to.bearing(p), away = to.range(p, at);
            half = higher(half, to.half_angle(d, away > 1 ? away : 1));
            if (!i) first = at;
            const int turn = (at - first + Rays::TURN + Rays::TURN / 2) % Rays::TURN - Rays::TURN / 2;
            wide |= Rays::magnitude(turn) > WIDEST;
            low_end = turn < low_end ? turn : low_end;
            high_end = turn > high_end ? turn : high_end;
        }
        int most = 0;
        // Cells are at most so wide; lenses bend columns a little.
        const int pad = half + half / 8 + Rays::UNITS;
        wide |= pad > WIDEST;
        const int begin = Rays::sector(first + low_end - (wide ? 0 : pad));
        const int end = wide ? begin : Rays::sector(first + high_end + pad);
        for (int s = begin; s <= end; ++s)
            most = higher(most, to.floor_end(Rays::wrapped(s), foot_inside));
        limit[c] = (float)(wide ? (int)Rays::NONE : most);
        const int middle = Rays::wrapped(Rays::sector(first + (low_end + high_end) / 2));
        const int* const along = to.directions + 2 * middle;
        const float unit = 0.999f / (1 << Rays::BITS) / (1 << FloorFrame::BITS);
        float* const ways[] = {way_x, way_y, way_z};
        for (int i = 0; i < 3; ++i) {
            const float of_ray = i < 2 ? 1.0f / (1 << CellGrid::RAY_BITS) : 1.0f;
            ways[i][c] = unit * of_ray * ((float)frame.axes[i] * (float)along[0] +
                                          (float)frame.axes[3 + i] * (float)along[1]);
        }
    }

    void add(const Rays& to, int k, int kind) const {
        const int d = pixels[k];
        if (kind == MAY_STAND && !stands(k)) return;
        if (d < nearest) {
            to.add(to.block, {right[k], forward[k]}, z[k]);
            return;
        }
        const Rays::Point at = ray(k, d);
        to.add(to.block,
               {frame.right(at.right, at.forward, d), frame.forward(at.right, at.forward, d)}, d);
    }

    void run(const Rays& to, bool foot_inside) const {
        const Team& team = to.team;
        for (int c = team.rank; c < columns; c += team.size) {
            find_limit(c, to, foot_inside);
            const int k = obstacles[c];
            if (k >= 0) to.add(to.only, {right[k], forward[k]}, z[k]);
        }
        team.sync();
        // Heights are rounded a few times.
        const float step = (float)(rises[0] - 4), floor = (float)frame.height;
        const bool ramp = frame.has_ramp();
#if defined(__CUDA_ARCH__)
        for (int k = team.rank; k < rows * columns; k += team.size) {
            const int own = kind(k, k % columns, step, floor, ramp);
            if (own) add(to, k, own);
        }
        team.sync();
#else
        int kinds[Grid::MOST_COLUMNS];
        for (int row = rows - 1; row >= 0; --row) {
            const int first = row * columns;
#if defined(__clang__)
#pragma clang loop vectorize(assume_safety)
#endif
            for (int c = 0; c < columns; ++c) kinds[c] = kind(first + c, c, step, floor, ramp);
            for (int c = 0; c < columns; ++c)
                if (kinds[c]) add(to, first + c, kinds[c]);
        }
#endif
    }
};

} }  // namespace jaxdet
