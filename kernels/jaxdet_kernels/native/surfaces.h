// The cells of a frame on the floor, and the surfaces that they make.
// Twin of `_surfaces` in jaxdet/reference/_detect.py and of jaxdet/reference/_surfaces.py.
#pragma once
#include "creases.h"
#include "floor_frame.h"
#include "grid.h"
#include "runs.h"
#include "scan.h"
#include "team.h"

struct Surfaces {
    enum {
        MOST = 512,  // labels from here on become -1
        MARGIN = 8,  // this part of the columns at each side is the image's margin
        UNSEEN = 0x7fffffff,
    };
    // Where each setting is.
    enum { NEAREST, FARTHEST, CREASE_CELLS, MIN_CELLS, CREASE_MARGIN, BENT, SETTINGS };
    // Of a cell: it has a label or can be linked, a run begins or ends before it, it is linked with
    // the one above.
    enum { ON = 1, EDGE = 2, UP = 4 };

    int rows, columns;
    // (R, C): the frame's cells, z = 0: none.
    const int* x;
    const int* y;
    const int* z;
    const int* floor;
    // By depth: steps of a surface, limits of bends, heights that are floor.
    const int* steps;
    const int* limits;
    const int* rises;
    const int* settings;
    // (R, C)
    int* right;
    int* forward;
    int* height;
    int* label_out;
    unsigned char* keep;
    unsigned char* low;
    int* count_out;
    int* scratch;

    // The words of scratch memory of a team: `surfaces_words` in surfaces.py.
    struct Parts {
        Grid grid;
        // (grid) each: smoothed depths, then linked depths, then labels; what more there is.
        int* depth;
        int* other;
        int* step;
        // (R C): runs, and sizes by root.
        int* runs;
        int* sizes;
        // (grid) each.
        unsigned char* found;
        unsigned char* wide;
        // (R) each.
        int* counts;
        int* firsts;
        // How many cells have no label, in turn.
        int* left;
        int* sums;

        Parts(int rows, int columns, int* scratch) : grid(rows, columns) {
            const int cells = rows * columns, bytes = (grid.size + 3) / 4;
            depth = scratch;
            other = depth + grid.size;
            step = other + grid.size;
            runs = step + grid.size;
            sizes = runs + cells;
            found = (unsigned char*)(sizes + cells);
            wide = (unsigned char*)(sizes + cells + bytes);
            counts = sizes + cells + 2 * bytes;
            firsts = counts + rows;
            left = firsts + rows;
            sums = left + 2;
        }
    };

    // What is known of each surface, by its root.
    struct Known {
        // Its first cell; its top, then its number; 2 for each of its lowest cells that have floor
        // below them, less 3 for each steep one.
        int* first;
        int* top;
        int* level;
        // Whether it has such cells, one inside of the margins or one at the image's lower edge.
        unsigned char* certain;
    };

    // Where the cells of a row are on the floor.
    static void place_row(
        const FloorFrame& frame, const int* __restrict__ x, const int* __restrict__ y,
        const int* __restrict__ z, int* __restrict__ right, int* __restrict__ forward,
        int* __restrict__ height, int lane, int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES) {
            right[c] = frame.right(x[c], y[c], z[c]);
            forward[c] = frame.forward(x[c], y[c], z[c]);
            height[c] = frame.level(x[c], y[c], z[c]);
        }
        if (frame.has_ramp())
            for (int c = lane; c < n; c += Rows::LANES) height[c] -= frame.rise(forward[c]);
    }

    // Table entries by depth, at most Creases::MOST_STEP, and heights.
    static void look_up_row(
        const int* __restrict__ steps, const int* __restrict__ rises, const int* __restrict__ z,
        int* __restrict__ step, int* __restrict__ rise, int lane, int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES) {
            const int near = steps[z[c]];
            step[c] = near < Creases::MOST_STEP ? near : Creases::MOST_STEP;
            rise[c] = rises[z[c]];
        }
    }

    static void keep_row(
        const int* __restrict__ z, const int* __restrict__ height, const int* __restrict__ rise,
        unsigned char* __restrict__ keep, unsigned char* __restrict__ low, int* __restrict__ depth,
        int nearest, int farthest, int lane, int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES) {
            const int d = z[c];
            const bool above = height[c] > rise[c];
            keep[c] = (d >= nearest) & (d <= farthest) & above;
            low[c] = (d > 0) & !above;
            depth[c] = d > 0 ? d << Creases::BITS : (int)Creases::NONE;
        }
    }

    // Everything that is known of single cells.
    void start(const Team& team, const Parts& in) const {
        const Rows rows_of(team);
        const FloorFrame frame(floor);
        in.grid.frame(team, in.depth, Creases::NONE);
        in.grid.frame(team, in.other, Creases::NONE);
        in.grid.frame(team, in.step, 0);
        in.grid.frame(team, in.found, (unsigned char)0);
        in.grid.frame(team, in.wide, (unsigned char)0);
        for (int r = rows_of.first; r < rows; r += rows_of.step) {
            const int k = r * columns, at = in.grid.row(r), lane = rows_of.lane;
            place_row(
                frame, x + k, y + k, z + k, right + k, forward + k, height + k, lane, columns
            );
            look_up_row(steps, rises, z + k, in.step + at, in.other + at, lane, columns);
            keep_row(
                z + k, height + k, in.other + at, keep + k, low + k, in.depth + at,
                settings[NEAREST], settings[FARTHEST], lane, columns
            );
        }
    }

    static void linked_row(
        const int* __restrict__ z, const unsigned char* __restrict__ keep,
        const unsigned char* __restrict__ crease, int* __restrict__ depth, int lane, int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES)
            depth[c] = keep[c] > crease[c] ? z[c] : (int)Creases::NONE;
    }

    static void links_of_row(
        const int* __restrict__ above, const int* __restrict__ here,
        const int* __restrict__ step_above, const int* __restrict__ step,
        unsigned char* __restrict__ out, int lane, int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES) {
            const int own = here[c], near = step[c];
            const bool on = own >= 0;
            const auto links = [&](int there, int other) {
                return on & (Creases::apart(own, there) <= (near < other ? near : other));
            };
            const bool edge = (on | (here[c - 1] >= 0)) & !links(here[c - 1], step[c - 1]);
            out[c] = on * ON + edge * EDGE + links(above[c], step_above[c]) * UP;
        }
    }

    // The runs of row r: from each edge to the next, where cells are ON.
    void put_runs(const Runs& runs, const unsigned char* row, int r) const {
        const Marks marks = {row, columns};
        int count = 0;
        for (int c = marks.next(0, EDGE); c < columns;) {
            const int begin = c;
            c = marks.next(c + 1, EDGE);
            if (row[begin] & ON) runs.put(r, count++, begin, c);
        }
        runs.counts[r] = count;
    }

    // Writes -1 before the i-th run of a row, from the run before on, and `value` in it.
    static void fill_run(const Runs& runs, int* out, int r, int i, int value) {
        int c = i ? runs.end(r, i - 1) : 0;
        for (const int begin = runs.begin(r, i); c < begin; ++c) out[c] = -1;
        for (const int end = runs.end(r, i); c < end; ++c) out[c] = value;
    }

    // Writes -1 after the last run of a row.
    void fill_rest(const Runs& runs, int* out, int r) const {
        const int count = runs.count(r);
        for (int c = count ? runs.end(r, count - 1) : 0; c < columns; ++c) out[c] = -1;
    }

    // Labels of the linked cells: the smallest cell of their component, -1 where that is small.
    void label(const Team& team, const Parts& in, const Runs& runs) const {
        const Rows rows_of(team);
        const int stride = in.grid.stride;
        for (int r = rows_of.first; r < rows; r += rows_of.step) {
            const int k = r * columns, at = in.grid.row(r);
            linked_row(z + k, keep + k, in.found + at, in.depth + at, rows_of.lane, columns);
        }
        team.sync();
        for (int r = rows_of.first; r < rows; r += rows_of.step) {
            const int at = in.grid.row(r);
            links_of_row(
                in.depth + at - stride, in.depth + at, in.step + at - stride, in.step + at,
                in.wide + at, rows_of.lane, columns
            );
        }
        team.sync();
        for (int r = team.rank; r < rows; r += team.size) {
            put_runs(runs, in.wide + in.grid.row(r), r);
            for (int i = 0; i < runs.count(r); ++i) runs.start(r, i);
        }
        team.sync();
        for (int r = team.rank + 1; r < rows; r += team.size)
            runs.link_marked(team, r, in.wide + in.grid.row(r), UP);
        team.sync();
        runs.measure(team);
        team.sync();
        const int least = settings[MIN_CELLS];
        for (int r = rows_of.first; r < rows; r += rows_of.step) {
            int* const out = in.depth + in.grid.row(r);
            for (int i = rows_of.lane; i < runs.count(r); i += Rows::LANES) {
                const int root = runs.root(r, i);
                fill_run(runs, out, r, i, runs.sizes[root] < least ? -1 : root);
            }
            if (rows_of.lane == 0) fill_rest(runs, out, r);
        }
        team.sync();
    }

    // Kept cells without a label take that of the neighbour nearest in depth, ring by ring. In a
    // list, a cell is `r << 9 | c`.
    void give_back(const Team& team, const Parts& in) const {
        const Grid& grid = in.grid;
        int* const label = in.depth;
        int* const taken = in.runs;
        int* list = in.other;
        int* next = in.sizes;
        if (team.rank == 0) in.left[0] = 0;
        team.sync();
        for (int r = team.rank; r < rows; r += team.size) {
            const unsigned char* kept = keep + r * columns;
            const int* own = label + grid.row(r);
            int free = 0;
            for (int c = 0; c < columns; ++c) free += kept[c] & (own[c] < 0);
            if (!free) continue;
            int* out = list + team.add(in.left, free);
            for (int c = 0; c < columns; ++c)
                if (kept[c] & (own[c] < 0)) *out++ = r << 9 | c;
        }
        team.sync();
        const int rounds = settings[CREASE_CELLS] + settings[CREASE_MARGIN] + 1;
        for (int round = 0; round < rounds; ++round) {
            const int count = in.left[round & 1];
            if (count == 0) break;
            if (team.rank == 0) in.left[~round & 1] = 0;
            for (int i = team.rank; i < count; i += team.size) taken[i] = nearest_of(in, list[i]);
            team.sync();
            for (int i = team.rank; i < count; i += team.size) {
                const int r = list[i] >> 9, c = list[i] & 511;
                if (taken[i] >= 0)
                    label[grid.row(r) + c] = taken[i];
                else
                    next[team.add(in.left + (~round & 1), 1)] = list[i];
            }
            team.sync();
            if (in.left[~round & 1] == count) break;
            int* const list_before = list;
            list = next;
            next = list_before;
        }
    }

    // The label of the neighbour that is nearest in depth within the step, -1 where none is; of as
    // near ones the left, right, upper, lower one.
    int nearest_of(const Parts& in, int cell) const {
        const int r = cell >> 9, c = cell & 511, at = in.grid.row(r) + c;
        const int* const depth = z + r * columns + c;
        const int* const label = in.depth + at;
        int best = in.step[at] + 1, taken = -1;
        const auto look = [&](int there, int step) {
            if (label[there] < 0) return;
            const int apart = Creases::apart(depth[step], depth[0]);
            if (apart >= best) return;
            best = apart;
            taken = label[there];
        };
        look(-1, -1);
        look(1, 1);
        look(-in.grid.stride, -columns);
        look(in.grid.stride, columns);
        return taken;
    }

    static void edges_of_row(
        const int* __restrict__ label, unsigned char* __restrict__ out, int lane, int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES)
            out[c] = (label[c] >= 0) * ON + ((label[c] != label[c - 1]) | (c == 0)) * EDGE;
    }

    // Adds up what is known of the surfaces from the run begin .. end of row r.
    void look_at(
        const Team& team, const Known& known, int label, int r, int begin, int end
    ) const {
        const int k = r * columns, margin = columns / MARGIN;
        int top = -1, pairs = 0, steep = 0;
        for (int c = begin; c < end; ++c)
            top = height[k + c] > top ? height[k + c] : top;
        if (r + 1 < rows)
            for (int c = begin; c < end; ++c) {
                const int rises = height[k + c] - height[k + c + columns];
                const int goes = forward[k + c] - forward[k + c + columns];
                const bool outer = (c < margin) | (c >= columns - margin);
                const int lowest = low[k + c + columns];
                pairs += lowest;
                steep += lowest & ((outer ? rises : 3 * rises) > goes);
            }
        team.least(known.first + label, k + begin);
        team.most(known.top + label, top);
        if (pairs) team.add(known.level + label, 2 * pairs - 3 * steep);
        if (pairs || r + 1 == rows || (begin < columns - margin && end > margin))
            known.certain[label] = 1;
    }

    // Whether a surface is floor that the sensor bends up.
    bool is_bent(const Known& known, int label) const {
        const bool flat = known.level[label] > 0 || !known.certain[label];
        return flat && known.top[label] <= settings[BENT];
    }

    // Numbers the surfaces in the order of their first cells, but for bent floor.
    void number(const Team& team, const Parts& in, const Runs& runs) const {
        const Rows rows_of(team);
        const Known known = {in.sizes, in.other, in.step, in.wide};
        const int* const label = in.depth;
        const auto label_of = [&](int r, int i) {
            return label[in.grid.row(r) + runs.begin(r, i)];
        };
        for (int r = rows_of.first; r < rows; r += rows_of.step) {
            const int at = in.grid.row(r);
            edges_of_row(label + at, in.found + at, rows_of.lane, columns);
        }
        team.sync();
        for (int r = team.rank; r < rows; r += team.size) {
            put_runs(runs, in.found + in.grid.row(r), r);
            for (int i = 0; i < runs.count(r); ++i) {
                const int own = label_of(r, i);
                known.first[own] = UNSEEN;
                known.top[own] = -1;
                known.level[own] = 0;
                known.certain[own] = 0;
            }
        }
        team.sync();
        for (int r = rows_of.first; r < rows; r += rows_of.step)
            for (int i = rows_of.lane; i < runs.count(r); i += Rows::LANES)
                look_at(team, known, label_of(r, i), r, runs.begin(r, i), runs.end(r, i));
        team.sync();
        for (int r = team.rank; r < rows; r += team.size) {
            int firsts = 0;
            for (int i = 0; i < runs.count(r); ++i) {
                const int own = label_of(r, i);
                const bool first = known.first[own] == runs.cell(r, runs.begin(r, i));
                firsts += first && !is_bent(known, own);
            }
            in.firsts[r] = firsts;
        }
        team.sync();
        const int count = PrefixSum::run(team, in.firsts, rows, in.sums);
        if (team.rank == 0) *count_out = count;
        for (int r = team.rank; r < rows; r += team.size) {
            int number = in.firsts[r];
            for (int i = 0; i < runs.count(r); ++i) {
                const int own = label_of(r, i);
                if (known.first[own] != runs.cell(r, runs.begin(r, i))) continue;
                known.top[own] = is_bent(known, own) ? -1 : number++;
            }
        }
        team.sync();
        for (int r = rows_of.first; r < rows; r += rows_of.step) {
            int* const out = label_out + r * columns;
            for (int i = rows_of.lane; i < runs.count(r); i += Rows::LANES) {
                const int number = known.top[label_of(r, i)];
                fill_run(runs, out, r, i, number < MOST ? number : -1);
                if (number >= 0) continue;
                for (int c = runs.begin(r, i); c < runs.end(r, i); ++c) keep[r * columns + c] = 0;
            }
            if (rows_of.lane == 0) fill_rest(runs, out, r);
        }
    }

    // All threads of the team must call it.
    void run(const Team& team) const {
        const Parts in(rows, columns, scratch);
        start(team, in);
        team.sync();
        // The sets are done with `other` when the next are started.
        const Runs runs = {rows, columns, in.runs, in.counts, {in.other}, in.sizes};
        const Creases creases = {
            in.grid, settings[CREASE_CELLS], settings[MIN_CELLS], settings[CREASE_MARGIN],
            limits, z, keep, in.step, in.depth, in.other, in.found, in.wide, runs,
        };
        creases.run(team);
        label(team, in, runs);
        give_back(team, in);
        number(team, in, runs);
        team.sync();
    }
};
