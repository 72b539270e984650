// Profile of the floor: the cells by forward distance and by height above a plane. Twin of
// jaxdet/reference/_floor_profile.py, which documents the constants.
#pragma once
#include "floor_planes.h"
#include "warp.h"

namespace jaxdet { namespace {

// Shape of the floor ahead of its plane: a ramp, or a step down or up.
struct FloorAhead {
    // Distance at which it begins [depth units]; pitch of the ramp relative to the plane, positive
    // uphill, 0 if there is no ramp [angle steps]; height of the step, positive downwards, 0 if there
    // is no step [depth units].
    int start = 0, turn = 0, drop = 0;
};

struct FloorProfile {
    enum {
        // Number of arrays with a value per distance bin. In this order they hold: index of the bin's
        // first cell; votes for a flat floor; upper bound of votes; two tolerances; two counts of the
        // cells of the plane, a ramp or a step; index at which `sort` writes the bin's next cell.
        ROW_ARRAYS = 8
    };
    FloorAngles angles;
    const FloorSettings* settings;
    // The measured cells inside the left and right margins of the image.
    FloorCells cells;
    // Scratch: `key` holds one `FloorKey`, `rows` ROW_ARRAYS * (runs + 1) words, and `places` 4 words
    // per cell.
    unsigned long long* key;
    int *rows, *places;

    // Number of distance bins, and half the number of height bins. Height bin half() begins at the
    // plane.
    int runs() const { return settings->runs; }
    int half() const { return settings->half; }
    int* row(int k) const { return rows + k * (runs() + 1); }
    // Index of the first cell of each distance bin, in the order of sorted cells.
    int* begin() const { return row(0); }
    // Votes for a flat floor by the cells of all nearer distance bins, for each distance bin.
    int* flat() const { return row(1); }
    // Tolerances at each distance bin, for the coarse and for the fine lattice of ramps [depth units].
    int* coarse() const { return row(3); }
    int* fine() const { return row(4); }
    int* cursor() const { return row(7); }

    // Distance of the centre of bin k [depth units].
    int middle(int k) const {
        const int bits = settings->run_bits;
        return (k << bits) + (1 << bits >> 1);
    }

    // Computes the tolerances at each distance bin, and sorts the heights of the cells above the plane
    // by distance bin.
    void sort(const Team& team, FloorPlane plane) const {
        const int n = runs(), run_bits = settings->run_bits;
        const int rise_bits = settings->rise_bits, middle_rise = half();
        const int noise = settings->noise, per_z = settings->fine.per_z;
        const FloorSlack wide({settings->profile_base, per_z}, noise, plane.height);
        const FloorSlack tight({settings->rough.base, per_z}, noise, plane.height);
        for (int k = team.rank; k <= n; k += team.size) {
            coarse()[k] = wide.at(middle(k));
            fine()[k] = tight.at(middle(k));
            begin()[k] = 0;
        }
        team.sync();
        const FloorDirection down = angles.down(plane), forward = angles.forward(plane);
        int* run = places;
        int *high = run + cells.count, *sorted = high + cells.count, *at = sorted + cells.count;
        for (int i = team.rank; i < cells.count; i += team.size) {
            const int x = cells.x[i], y = cells.y[i], z = cells.z[i];
            const int ahead = forward.along(x, y, z) >> run_bits;
            const int up = ((plane.height - down.along(x, y, z)) >> rise_bits) + middle_rise;
            run[i] = ahead >= 0 && ahead < n && up < 2 * middle_rise ? ahead : -1;
            high[i] = up > 0 ? up : 0;
        }
        for (int i = team.rank; i < cells.count; i += team.size)
            if (run[i] >= 0) team.atomic_add(begin() + run[i], 1);
        team.sync();
        const Warp warp(team);
        if (warp.index == 0) {
            warp.exclusive_sum(begin(), n);
            for (int k = warp.lane; k <= n; k += warp.size) cursor()[k] = begin()[k];
        }
        team.sync();
        for (int i = team.rank; i < cells.count; i += team.size)
            if (run[i] >= 0) {
                const int place = team.atomic_add(cursor() + run[i], 1);
                sorted[place] = high[i];
                at[place] = run[i];
            }
        team.sync();
    }

    // Height bins of the cells, sorted by distance bin.
    const int* heights() const { return places + 2 * cells.count; }

    // N ranges of height bins, one per candidate floor: inliers are in bins `least` to `over` - 1, cells
    // in bins lower than `deep` are clearly below the floor.
    template <int N> struct Ranges {
        int over[N], least[N], deep[N];
    };

    // Counts the cells of a distance bin in N ranges: adds the inliers to `on`, and the cells clearly
    // below the floor to `low`.
    template <int N> void count(int k, const Ranges<N>& ranges, int* on, int* low) const {
        for (int i = begin()[k]; i < begin()[k + 1]; i++) {
            const int height = heights()[i];
            for (int w = 0; w < N; w++) {
                on[w] += (height >= ranges.least[w]) & (height < ranges.over[w]);
                low[w] += height < ranges.deep[w];
            }
        }
    }

    // Counts the cells of distance bin k for N floors at heights `up` above the plane, with tolerance
    // `slack` [depth units]: adds the inliers to `on`, and the cells clearly below the floor to `low`.
    template <int N> void count(int k, const int* up, int slack, int* on, int* low) const {
        if (begin()[k] == begin()[k + 1]) return;
        const int bits = settings->rise_bits;
        Ranges<N> ranges;
        for (int w = 0; w < N; w++) {
            ranges.over[w] = ((up[w] + slack) >> bits) + half();
            ranges.least[w] = ((up[w] - slack) >> bits) + half();
            ranges.deep[w] = ((up[w] - FloorScore::BELOW * slack) >> bits) + half();
        }
        count<N>(k, ranges, on, low);
    }

    // Returns the number of inliers in distance bin k of a floor at `height` above the plane [depth
    // units]. Sets `low` to the number of cells clearly below this floor.
    int on(int k, int height, int slack, int& low) const {
        int found = 0;
        low = 0;
        count<1>(k, &height, slack, &found, &low);
        return found;
    }

    // Whether cells extend over more than the setting `spread`. The nearest and the farthest tenth of the
    // cells are ignored; `first` is set to the distance bin of the nearest remaining cell. `counts` has the
    // number of cells per distance bin.
    bool extend(const int* counts, int& first) const {
        long long total = 0, running = 0;
        for (int k = 0; k < runs(); k++) total += counts[k];
        int last = first = -1;
        for (int k = 0; k < runs(); k++) {
            running += counts[k];
            if (first < 0 && 10 * running >= total) first = k;
            if (last < 0 && 10 * running >= 9 * total) last = k;
        }
        return middle(last) - middle(first) > settings->spread;
    }

    // Number of cells in distance bin k that are lower than `height` above the plane [depth units].
    int under(int k, int height) const {
        const int end = (height >> settings->rise_bits) + half();
        int count = 0;
        for (int i = begin()[k]; i < begin()[k + 1]; i++) count += heights()[i] < end;
        return count;
    }
};

} }  // namespace jaxdet
