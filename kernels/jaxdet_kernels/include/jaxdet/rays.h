// Free floor along fixed bearings from the ground projection of the camera, here called the foot.
// Lengths are in depth units. Twin of jaxdet/reference/_rays.py.
#pragma once
#include "cells.h"
#include "free.h"
#include "grid.h"
#include "square_root.h"

namespace jaxdet { namespace {

struct Rays {
    enum {
        RAYS = 1440,
        UNIT_BITS = 4,
        UNITS = 1 << UNIT_BITS,  // units of a bearing between neighbouring rays
        TURN = RAYS * UNITS,
        RATIO_BITS = 12,
        BITS = 13,       // fraction bits of a direction
        TURN_BITS = 13,  // fraction bits of a small angle
        MOST_WIDER = 8,  // largest ratio of a column's width at its end to that at its neighbour's end
        END_BITS = 2,
        NONE = 0x7fffffff,
        INFINITE = 0x7f800000  // infinity as float32
    };
    // Point on the floor: position, bearing in units of 1 / TURN of a turn, and range from the foot.
    struct Point { int right, forward, bearing, range; };

    const FreeFloor& floor;  // free floor, whose `run` has finished
    const int* angles;       // (2^RATIO_BITS + 1,) bearings up to an eighth of a turn, by tangent
    const int* directions;   // (2, RAYS, 2): directions of rays, and of the left edges of their sectors
    // For each ray: start of the floor; end of the floor, as in `packed`; squared range of the nearest
    // obstacle, as the bits of a float32.
    int *start, *stop, *block;
    int* polar;  // (columns, 2, 2): bearing and range of the start and the end of each column's floor
    int turn;    // half a cell's angle [rad], with TURN_BITS fraction bits

    static int magnitude(int a) { return a < 0 ? -a : a; }

    // Quotient a / b, rounded down, for a below 2^52 and b from 1 to 2^33. It is computed in float64,
    // which is faster: quotients below 2^19 are exact, but larger ones may be rounded up.
    static long long floored(long long a, long long b) {
        const double all = (double)a / (double)b;
        const long long whole = (long long)all;
        return whole - ((double)whole > all);
    }
    static int quotient(int a, int b) { return (int)((double)a / (double)b); }

    // A float32 and its bits; bits of positive floats compare like the floats.
    union Float {
        float value;
        int bits;
    };

    // Bearing of a point, 0 ahead, clockwise as seen from above.
    __attribute__((always_inline)) int bearing(int right, int forward) const {
        const int aside = magnitude(right), ahead = magnitude(forward);
        const int low = aside < ahead ? aside : ahead, high = aside < ahead ? ahead : aside;
        int angle = angles[quotient(low << RATIO_BITS, high ? high : 1)];
        angle = aside > ahead ? TURN / 4 - angle : angle;
        angle = forward < 0 ? TURN / 2 - angle : angle;
        return right < 0 ? -angle : angle;
    }

    // Signed angle from one bearing to another, at most half a turn.
    static int turn_to(int from, int to) {
        const int by = to - from;
        return by >= TURN / 2 ? by - TURN : by < -TURN / 2 ? by + TURN : by;
    }

    // Index of the sector of a bearing, before `wrapped` brings it to 0 .. RAYS - 1.
    static int sector(int bearing) { return (bearing + TURN / 2 + UNITS / 2) >> UNIT_BITS; }
    static int wrapped(int sector) {
        return sector < 0 ? sector + RAYS : sector < RAYS ? sector : sector - RAYS;
    }

    // Distance from the foot along the ray nearest to a bearing; float64 is exact below 2^53.
    __attribute__((always_inline)) int range(int right, int forward, int bearing) const {
        const int* const way = directions + 2 * wrapped(sector(bearing));
        const double sum = (double)right * way[0] + (double)forward * way[1] + (1 << (BITS - 1));
        return (int)((sum < 0 ? -sum : sum) * (1.0 / (1 << BITS)));
    }
    __attribute__((always_inline)) Point point(int right, int forward) const {
        const int at = bearing(right, forward);
        return {right, forward, at, range(right, forward, at)};
    }

    // Key by which ends of the floor are compared, smallest first: by range, then an obstacle before a
    // drop before other reasons.
    static int packed(int range, int why) { return range << END_BITS | ((why - 1) & 3); }

    void begin() const {
        for (int i = floor.team.rank; i < RAYS; i += floor.team.size) {
            start[i] = -1;
            stop[i] = NONE;
            block[i] = INFINITE;
        }
        floor.team.sync();
    }

    // Start (`which` 0) or end (1) of the floor of column c.
    Point end_point(int c, int which) const {
        const int k = 2 * c + which;
        return {floor.line_out[2 * k], floor.line_out[2 * k + 1], polar[2 * k], polar[2 * k + 1]};
    }
    Point near(int c) const { return end_point(c, 0); }
    Point far(int c) const { return end_point(c, 1); }

    void find_points() const {
        for (int k = floor.team.rank; k < 2 * floor.columns; k += floor.team.size) {
            const Point p = point(floor.line_out[2 * k], floor.line_out[2 * k + 1]);
            polar[2 * k] = p.bearing;
            polar[2 * k + 1] = p.range;
        }
        floor.team.sync();
    }

    // Whether floor is visible in a column, not only an obstacle.
    bool is_seen(int c) const {
        if (c < 0 || c >= floor.columns) return false;
        const Point a = near(c), b = far(c);
        const bool any = a.right || a.forward || b.right || b.forward;
        const bool is_point = a.right == b.right && a.forward == b.forward;
        return any && !(is_point && floor.end_out[c] == FreeFloor::OBSTACLE);
    }

    // Whether the floor of a column begins behind the foot and ends in front of it. If so, sets
    // `crossing` to the lateral position at which it passes the foot.
    bool passes(int c, long long* crossing) const {
        if (!is_seen(c)) return false;
        const Point a = near(c), b = far(c);
        if (a.forward > 0 || b.forward < 0 || b.forward <= a.forward) return false;
        const long long across = (long long)(b.right - a.right) * -a.forward;
        *crossing = a.right + floored(across, b.forward - a.forward);
        return true;
    }

    bool is_foot_inside() const {
        bool found = false;
        for (int c = floor.team.rank; c + 1 < floor.columns; c += floor.team.size) {
            long long one = 0, other = 0;
            if (!passes(c, &one) || !passes(c + 1, &other)) continue;
            found |= (one < other ? one : other) <= 0 && (one < other ? other : one) >= 0;
        }
        return floor.team.any(found);
    }

    // Calls `put` with each sector that a segment crosses and with the segment's range in this sector, the
    // smallest if LEAST, otherwise the largest.
    template <bool LEAST, class Put> void sweep(Point first, Point last, Put put) const {
        const int turn = turn_to(first.bearing, last.bearing);
        const Point &leftmost = turn < 0 ? last : first, &rightmost = turn < 0 ? first : last;
        const int begin = sector(leftmost.bearing);
        const int end = sector(leftmost.bearing + magnitude(turn));
        const int x = last.right - first.right, y = last.forward - first.forward;
        const long long cross = (long long)first.right * y - (long long)first.forward * x;
        const long long area = (cross < 0 ? -cross : cross) << BITS;
        const int lowest = first.range < last.range ? first.range : last.range;
        const int highest = first.range < last.range ? last.range : first.range;
        int left = leftmost.range;
        for (int s = begin; s <= end; ++s) {
            int right = rightmost.range;
            if (s < end) {
                const int* const edge = directions + 2 * (RAYS + wrapped(s + 1));
                const long long over = (long long)edge[0] * y - (long long)edge[1] * x;
                const long long all = floored(area, over ? over < 0 ? -over : over : 1);
                right = all < lowest ? lowest : all > highest ? highest : (int)all;
            }
            put(wrapped(s), LEAST == (left < right) ? left : right);
            left = right;
        }
    }

    void end_at(Point first, Point last, int why) const {
        sweep<true>(first, last, [&](int ray, int range) {
            floor.team.atomic_min(stop + ray, packed(range, why));
        });
    }

    void begin_at(Point first, Point last, bool foot_inside) const {
        if (foot_inside)
            end_at(first, last, FreeFloor::UNKNOWN);
        else
            sweep<false>(first, last, [&](int ray, int range) {
                floor.team.atomic_max(start + ray, range);
            });
    }

    // Rotates a point clockwise about the foot by a small angle [rad], with TURN_BITS fraction bits.
    Point turned(Point p, int by) const {
        return point(p.right + (int)((long long)p.forward * by >> TURN_BITS),
                     p.forward + (int)((long long)p.right * -by >> TURN_BITS));
    }

    // Adds the side of a column whose neighbour shows no floor; `by` is the angle from the middle of
    // the column to this side, as in `turned`.
    void add_side(int c, int by, bool foot_inside) const {
        const Point begin = turned(near(c), by), end = turned(far(c), by);
        begin_at(near(c), begin, foot_inside);
        end_at(far(c), end, floor.end_out[c]);
        end_at(end, begin, FreeFloor::UNKNOWN);
    }

    // Adds the far boundary of the floor between column c and the next one, as three segments. The
    // first begins at the end of the column that ends nearer, and leads halfway to the point of the
    // other column at the same forward distance. The second follows the other column to its end, still
    // halfway between the two. The third leads to the end of the other column.
    void add_between(int c) const {
        const bool nearer = far(c).forward <= far(c + 1).forward;
        const int brief = nearer ? c : c + 1, lasting = nearer ? c + 1 : c;
        const Point a = near(lasting), b = far(lasting), first = far(brief);
        const int run = b.forward - a.forward, most = run > 0 ? run : 0;
        int part = first.forward - a.forward;
        part = part < 0 ? 0 : part > most ? most : part;
        const int divisor = run > 1 ? run : 1;
        const int right = a.right + (int)floored((long long)(b.right - a.right) * part, divisor);
        const int ahead =
            a.forward + (int)floored((long long)(b.forward - a.forward) * part, divisor);
        const Point middle = point((first.right + right) >> 1, (first.forward + ahead) >> 1);
        const bool wider = ahead > 0 && b.forward > ahead;
        const long long widest = (long long)MOST_WIDER * ahead;
        const long long times = !wider ? 1 : b.forward < widest ? b.forward : widest;
        const int over = wider ? ahead : 1;
        const Point last = point(b.right + (int)floored((middle.right - right) * times, over),
                                 b.forward + (int)floored((middle.forward - ahead) * times, over));
        const int why = floor.end_out[brief];
        end_at(first, middle, why);
        end_at(middle, last, why == FreeFloor::OBSTACLE ? (int)FreeFloor::UNKNOWN : why);
        end_at(last, b, floor.end_out[lasting]);
    }

    // Adds the polygon of floor that the columns show. Ends in a sync.
    void add_floor(bool foot_inside) const {
        for (int c = floor.team.rank; c < floor.columns; c += floor.team.size) {
            if (!is_seen(c)) continue;
            if (!is_seen(c - 1)) add_side(c, -turn, foot_inside);
            if (!is_seen(c + 1)) {
                add_side(c, turn, foot_inside);
                continue;
            }
            begin_at(near(c), near(c + 1), foot_inside);
            add_between(c);
        }
        floor.team.sync();
    }

    // Range at which the floor on a ray ends, from the columns; 0 if no column shows floor on this ray.
    int floor_end(int ray, bool foot_inside) const {
        return (foot_inside || start[ray] >= 0) && stop[ray] < NONE ? stop[ray] >> END_BITS : 0;
    }

    // Range of the nearest obstacle on a ray, NONE if there is none.
    __attribute__((always_inline)) int range_of_block(int ray) const {
        if (block[ray] == INFINITE) return NONE;
        Float square;
        square.bits = block[ray];
        const int range = (int)SquareRoot::rounded(square.value);
        return range > 1 ? range : 1;
    }

    // Writes start and end of the free floor on each ray to `free_out` (RAYS, 2), and the reason of its
    // end to `end_out` (RAYS,). The team must have synced before. Ends in a sync.
    void put(bool foot_inside, int* free_out, int* end_out) const {
        for (int i = floor.team.rank; i < RAYS; i += floor.team.size) {
            const int blocked = range_of_block(i);
            const bool ends_here = blocked < floor_end(i, foot_inside);
            const int least = ends_here ? packed(blocked, FreeFloor::OBSTACLE) : (int)NONE;
            const int last = stop[i] < least ? stop[i] : least, from = foot_inside ? 0 : start[i];
            const bool free = from >= 0 && last < NONE && from < last >> END_BITS;
            const bool stands = blocked < NONE;
            free_out[2 * i] = free ? from : stands ? blocked : 0;
            free_out[2 * i + 1] = free ? last >> END_BITS : stands ? blocked : 0;
            const int why = stands ? FreeFloor::OBSTACLE : FreeFloor::UNKNOWN;
            end_out[i] = free ? (last + 1) & 3 : why;
        }
        floor.team.sync();
    }
};

// Nearest cell of an obstacle, or above the step height, in each sector of bearings. Its position is that
// of its nearest pixel or, if this pixel is nearer than the minimum depth, of the cell.
// The computation is in float32 as in the reference, with each operation rounded separately.
struct RayBlocks {
    // A tile is TILE rows of a column of cells; its nearest point blocks all sectors that the tile
    // covers. A thread processes the tiles of ABREAST columns together.
    enum { TILE = 4, CORNER_BITS = 12, WIDEST = Rays::TURN / 4 };
    enum { ABREAST = Warp::size > 1 ? 1 : (int)Grid::MOST_COLUMNS };
    // Indices of settings: STEP is the step height at depth 0; GROWTH is its increase per depth unit; NOISE
    // times depth and height of the camera is its minimum [1 / depth unit].
    enum { STEP, GROWTH, NOISE, SETTINGS };
    const FreeFloor& floor;  // the cells
    int nearest, farthest, highest;  // minimum and maximum depth, and maximum height, of obstacles
    const int* pixels;  // smallest measured depth of each cell
    // Rays of cells, (2, rows, columns), and of corners of tiles, (2, tiles + 1, columns + 1).
    const int *rays, *corners;
    // Axes of the floor, whose first two components are scaled for rays with RAY_BITS fraction bits; height
    // of the camera; settings of the step height; start and slope of the ramp.
    float axes[3][3], camera, step, growth, noise, ramp_start, ramp_slope;

    // If the floor is unknown, all points get the same height, so that all of them may be obstacles.
    RayBlocks(const FreeFloor& floor, const int* bounds, const FloorFrame& frame, const int* pixels,
              const int* rays, const int* corners, const float* settings)
        : floor(floor), nearest(bounds[FreeFloor::NEAREST]), farthest(bounds[FreeFloor::IN_RANGE]),
          highest(frame.valid ? bounds[FreeFloor::HIGHEST] : (int)FloorFrame::UNKNOWN),
          pixels(pixels), rays(rays), corners(corners),
          camera((float)(frame.valid ? frame.height : (int)FloorFrame::UNKNOWN)),
          step(settings[STEP]), growth(settings[GROWTH]),
          noise(settings[NOISE] * higher((float)frame.height, 0.0f)),
          ramp_start((float)frame.ramp_start),
          ramp_slope(frame.has_ramp() ? (float)frame.ramp_slope / (1 << FloorFrame::BITS) : 0.0f) {
        for (int i = 0; i < 9; ++i) {
            const float axis = (float)frame.axes[i] / (1 << FloorFrame::BITS);
            const float of_ray = i % 3 < 2 ? 1.0f / (1 << CellGrid::RAY_BITS) : 1.0f;
            axes[i / 3][i % 3] = i < 6 || frame.valid ? axis * of_ray : 0.0f;
        }
    }

    __attribute__((always_inline)) static float higher(float a, float b) { return a > b ? a : b; }

    // Component along a floor axis of the point at depth 1 on a ray.
    __attribute__((always_inline)) float along(int axis, float x, float y) const {
        return axes[axis][0] * x + axes[axis][1] * y + axes[axis][2];
    }

    // Squared range of the obstacle in cell k from the foot, as the bits of a float32; infinity if the
    // cell has no obstacle.
    __attribute__((always_inline)) int square(int k) const {
        const int pixel = pixels[k], own = floor.z[k], high = floor.height[k];
        const bool in_range = (own >= nearest) & (own <= farthest);
        const bool is_cell = (in_range & !floor.low[k] & (high <= highest)) | (floor.label[k] >= 0);
        const float depth = (float)((is_cell & (pixel < nearest)) ? own : pixel);
        const float x = (float)rays[k], y = (float)rays[floor.rows * floor.columns + k];
        const float right = along(0, x, y), forward = along(1, x, y), down = along(2, x, y);
        const float ramp = higher(forward * depth - ramp_start, 0.0f) * ramp_slope;
        const float above = camera - down * depth - ramp;
        const bool is_pixel = (pixel >= nearest) & (pixel <= farthest) & (above <= (float)highest) &
                              (above > higher(step + growth * depth, noise * depth));
        const Rays::Float found = {(right * right + forward * forward) * (depth * depth)};
        return (is_cell | is_pixel) ? found.bits : (int)Rays::INFINITE;
    }

    // Lowers `least[i]`, for i below n, to the squared range of the obstacle in cell k + i, if smaller.
    void lower(int* least, int k, int n) const {
        JAXDET_VECTORIZE
        for (int i = 0; i < n; ++i) {
            const int found = square(k + i);
            least[i] = found < least[i] ? found : least[i];
        }
    }

    // Bearing of the ray through corner k of the tiles.
    __attribute__((always_inline)) int bearing(const Rays& to, int k) const {
        const int all = num_corners(floor.rows, floor.columns);
        const float x = (float)corners[k], y = (float)corners[all + k];
        return to.bearing((int)(along(0, x, y) * (1 << CORNER_BITS)),
                          (int)(along(1, x, y) * (1 << CORNER_BITS)));
    }

    static int tiles(int rows) { return (rows + TILE - 1) / TILE; }
    static int num_corners(int rows, int columns) {
        return (tiles(rows) + 1) * (columns + 1);
    }

    // Adds the nearest point of a tile to the sectors between its corners, or to all sectors if the
    // tile may contain the foot.
    __attribute__((always_inline)) void add(const Rays& to, int square, int a, int b, int c,
                                            int d) const {
        const int turns[] = {Rays::turn_to(a, b), Rays::turn_to(a, c), Rays::turn_to(a, d)};
        int left = 0, right = 0;
        for (int by : turns) {
            left = by < left ? by : left;
            right = by > right ? by : right;
        }
        const bool wide = right - left > WIDEST;
        const int begin = wide ? 0 : Rays::sector(a + left);
        const int end = wide ? (int)Rays::RAYS - 1 : Rays::sector(a + right);
        for (int s = begin; s <= end; ++s) {
            int* const place = to.block + Rays::wrapped(s);
            if (square < *place) to.floor.team.atomic_min(place, square);
        }
    }

    // Adds the obstacles of all tiles; `bearings` is scratch memory, a word per corner. Ends in a sync.
    void run(const Rays& to, int* bearings) const {
        const Team& team = floor.team;
        const int rows = floor.rows, columns = floor.columns;
        const int all = num_corners(rows, columns), groups = (columns + ABREAST - 1) / ABREAST;
        JAXDET_VECTORIZE
        for (int k = team.rank; k < all; k += team.size) bearings[k] = bearing(to, k);
        team.sync();
        for (int group = team.rank; group < tiles(rows) * groups; group += team.size) {
            const int tile = group / groups, first = group % groups * ABREAST;
            const int n = columns - first < ABREAST ? columns - first : (int)ABREAST;
            int least[ABREAST];
            for (int i = 0; i < n; ++i) least[i] = Rays::INFINITE;
            for (int row = tile * TILE; row < rows && row < (tile + 1) * TILE; ++row)
                lower(least, row * columns + first, n);
            for (int i = 0; i < n; ++i) {
                const int* const upper = bearings + tile * (columns + 1) + first + i;
                const int* const lower = upper + columns + 1;
                if (least[i] != Rays::INFINITE)
                    add(to, least[i], upper[0], upper[1], lower[0], lower[1]);
            }
        }
        team.sync();
    }
};

} }  // namespace jaxdet
