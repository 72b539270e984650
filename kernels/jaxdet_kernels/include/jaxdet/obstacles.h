// Groups surfaces into obstacles. Twin of `obstacles` in jaxdet/reference/_obstacles.py.
#pragma once
#include "arena.h"
#include "bits.h"
#include "cell_list.h"
#include "contraction.h"
#include "evidence.h"
#include "small_surfaces.h"
#include "straight_parts.h"

namespace jaxdet { namespace {

struct Obstacles {
    typedef unsigned long long Key;
    enum { MAX_SURFACES = 512, MAX_LABELS = 1024, THINNEST = 3 };
    // Indices of `counts`.
    enum { SURFACES, WHOLE, GROUPS, NEAR, CLOSE, PARTS, LISTED, COUNTS };
    // Indices of `settings`, in the order of `obstacle_tables` in jaxdet/stages/_tables.py; lengths are
    // in depth units. NO_STEP is the depth step of surfaces that do not face each other, and OFFSET is
    // the constant term of the evidence.
    enum {
        FARTHEST, LATERAL, FORWARD, GAP, CONTACT, BEND, SIDE, MIN_SIZE, MIN_CELLS, NO_STEP, OFFSET
    };
    // Number of words of fast memory: shared memory on CUDA, the stack on the CPU.
    enum { FAST = Warp::size > 1 ? 4096 : (int)Evidence::FAST };
    static_assert((int)FAST >= (int)Evidence::FAST, "room for a batch of pairs");
    int* fast;  // FAST words, aligned to 16 bytes; each stage reuses them
    int rows, columns;
    // Surface, position in the camera optical frame, and position on and height above the floor, of
    // each cell [depth units]; and whether it is free. Surfaces are numbered in the order of their first
    // cells.
    const int *surface, *x, *y, *z, *right, *forward, *height;
    const unsigned char* free;
    const int* settings;
    Trees trees;
    int* label;  // result: obstacle of each cell, -1 = none
    int* total;  // result: number of obstacles

    // Scratch. `pairs` holds, one after the other: contacts between surfaces, values of surfaces, sums
    // of pairs, and the nearest cells of the contours of obstacles.
    int slots;
    Key *pairs, *of_surfaces, *best, *turns;
    int *between, *list, *close, *packed, *stack, *line_x, *line_y, *line_column, *start;
    unsigned char* near_pairs;
    int* bits;
    CellList listed;  // labels are first surfaces, then merged surfaces, then parts of obstacles
    Extents first, whole, last;  // of surfaces, of merged surfaces, and of obstacles or their parts
    int *group, *number, *small, *spare, *over, *counts, *parts, *part_of;

    // Allocates the arrays.
    void allocate(Arena& arena) {
        const size_t cells = (size_t)rows * columns;
        slots = cells < MAX_SURFACES ? (int)cells : MAX_SURFACES;
        const size_t all = (size_t)slots * slots;
        const size_t labels = cells < MAX_LABELS ? cells : (size_t)MAX_LABELS;
        const size_t sums = Facing::SUMS * all / 2, keys = (size_t)slots * columns;
        arena.take(2 * (sums > keys ? sums : keys), pairs);
        arena.take(2 * keys, of_surfaces);
        arena.take(2 * slots, best);
        arena.take(4 * Contraction::TURNS, turns);
        arena.take(all, between);
        arena.take(all / 2, list, close);
        arena.take((all / 2 + 3) / 4, near_pairs);
        arena.take(cells + slots, packed, stack);
        arena.take(labels + 1, start);
        Extents* const extents[] = {&first, &whole, &last};
        for (Extents* of : extents) of->allocate(arena.words(Extents::FIELDS * labels), (int)labels);
        arena.take(labels, group, number, small, over);
        arena.take(2 * labels + 1, spare, parts);
        arena.take(COUNTS, counts);
        listed.count = counts + LISTED;
        arena.take(cells, line_x, line_y, line_column);
        arena.take(cells, listed.cell, listed.label, listed.right, listed.forward);
        arena.take(2 * (rows_bits().count() + columns_bits().count()), bits);
        part_of = (int*)of_surfaces;
    }

    // Groups surfaces into obstacles, sorted by distance. Ends in a sync.
    void run(const Team& team) const {
        if (team.rank == 0) {
            for (int k = 0; k < COUNTS; ++k) counts[k] = 0;
            *total = 0;
        }
        team.sync();
        listed.take(team, surface, free, right, forward, columns, bits_of(0), bits_of(1), label,
                    counts + SURFACES);
        join_small(team);
        pack(team);
        const Contours contours = contours_of(counts[WHOLE], whole, of_surfaces);
        contours.find(team, listed);
        contours.list(team);
        find_evidence(team, contours);
        Contraction{counts[WHOLE], between, best, turns, group}.run(team);
        number_groups(team, counts[WHOLE], counts + GROUPS);
        last.join(team, counts[GROUPS], whole, counts[WHOLE], number);
        straighten(team, contours);
        order(team);
    }

    Contours contours_of(int count, const Extents& extents, Key* nearest) const {
        return {count, rows, columns, right, forward, extents.column_low, extents.column_high, nearest,
                start, line_x, line_y, line_column};
    }

    void measure(const Team& team, const Extents& extents, int count) const {
        extents.measure(team, count, listed, columns, x, z, height);
    }

    // Computes the trimmed extremes of a value for each label: `over` cells are trimmed at each end.
    void trim(
        const Team& team, const Extents& extents, int count, const int* value, const int* low,
        const int* high, int* least, int* most
    ) const {
        int* const start = 2 * count < FAST ? fast : spare;
        const Trimmed trimmed = {count, *listed.count, listed.label, value, extents.cells, low, high,
                                 over, least, most, start, start + count + 1, (int*)pairs};
        trimmed.run(team);
    }

    // Sets `over`, the number of cells to trim, for this thread's labels. It is 0 for labels whose size
    // test does not depend on the trimmed width, since their untrimmed width is sufficient. Returns
    // whether any is not 0.
    bool width_decides(const Team& team, const Extents& extents, int count) const {
        bool some = false;
        for (int l = team.rank; l < count; l += team.size) {
            const int size = settings[MIN_SIZE];
            extents.left[l] = extents.right_low[l];
            extents.right[l] = extents.right_high[l];
            const bool decides = extents.height(l) < size && extents.width(l) >= size;
            over[l] = decides ? extents.cells[l] / Extents::TRIM : 0;
            some |= over[l] > 0;
        }
        return some;
    }

    // Measures the trimmed width of each label; `over` must have been set.
    void measure_width(const Team& team, const Extents& extents, int count) const {
        trim(team, extents, count, listed.right, extents.right_low, extents.right_high, extents.left,
             extents.right);
    }

    bool is_large(const Extents& extents, int l) const {
        return extents.width(l) >= settings[MIN_SIZE] || extents.height(l) >= settings[MIN_SIZE];
    }

    // Numbers the groups of `count` labels in the order of their smallest labels, which is that of
    // their first cells. Writes the number of each label to `number`, and how many groups there are to
    // `groups`. Ends in a sync.
    void number_groups(const Team& team, int count, int* groups) const {
        const Warp warp(team);
        for (int l = team.rank; l < count; l += team.size) spare[l] = group[l] == l;
        team.sync();
        if (warp.index == 0) *groups = warp.exclusive_sum(spare, count);
        team.sync();
        for (int l = team.rank; l < count; l += team.size) number[l] = spare[group[l]];
        team.sync();
    }

    // Merges small surfaces with surfaces that they touch. Sets `number`, the merged surface of each
    // surface, and the extents `whole` of merged surfaces.
    void join_small(const Team& team) const {
        const int count = counts[SURFACES];
        measure(team, first, count);
        if (team.any(width_decides(team, first, count))) measure_width(team, first, count);
        bool some = false;
        for (int l = team.rank; l < count; l += team.size) {
            small[l] = !is_large(first, l) || first.rows_of(l) < THINNEST ||
                       first.columns_of(l) < THINNEST;
            group[l] = l;
            some |= small[l];
        }
        if (team.any(some)) {
            const SmallSurfaces joining = {count, rows, columns, settings[CONTACT], listed, surface,
                                           z, small, (int*)pairs, {group}};
            joining.run(team);
        }
        number_groups(team, count, counts + WHOLE);
        whole.join(team, counts[WHOLE], first, count, number);
    }

    // Bitmap of the cells with a surface (0) or of the free cells (1), by rows or by columns.
    BitRows rows_bits() const { return BitRows(rows, columns, nullptr); }
    BitRows columns_bits() const { return BitRows(columns, rows, nullptr); }
    BitRows bits_of(int k) const {
        return BitRows(rows, columns, bits + k * rows_bits().count());
    }
    BitRows transposed(int k) const {
        const int* after = bits + 2 * rows_bits().count();
        return BitRows(columns, rows, (int*)after + k * columns_bits().count());
    }

    // Replaces the labels of listed cells by their merged surfaces, and packs these with the depths.
    void pack(const Team& team) const {
        for (int i = team.rank; i < *listed.count; i += team.size) {
            const int own = number[listed.label[i]], k = listed.cell[i];
            listed.label[i] = own;
            packed[k] = Packed(own, z[k]).word;
        }
        for (int k = 0; k < 2; ++k) {
            transposed(k).clear_padding(team);
            bits_of(k).transpose(team, transposed(k));
        }
        team.sync();
    }

    // Computes the evidence between all pairs of surfaces.
    void find_evidence(const Team& team, const Contours& contours) const {
        const int count = counts[WHOLE], gap = settings[GAP];
        for (int l = team.rank; l < count; l += team.size) over[l] = whole.cells[l] / Extents::TRIM;
        for (int ahead = 0; ahead < 2; ++ahead)
            trim(team, whole, count, ahead ? listed.forward : listed.right,
                 ahead ? whole.forward_low : whole.right_low,
                 ahead ? whole.forward_high : whole.right_high, ahead ? whole.near : whole.left,
                 ahead ? whole.far : whole.right);
        team.sync();
        const bool fits = (size_t)count * count / 2 <= FAST * sizeof(int);
        unsigned char* const near = fits ? (unsigned char*)fast : near_pairs;
        const Evidence evidence = {count, settings[LATERAL], settings[FORWARD], gap, settings[NO_STEP],
                                   whole, contours, trees, near, pairs, list, counts + NEAR, close,
                                   counts + CLOSE, between, fast};
        evidence.find_near(team);
        const Facing in_rows = {bits_of(0), bits_of(1), packed, x, columns, 1, true, gap, near, pairs};
        const Facing in_columns = {transposed(0), transposed(1), packed, y, 1, columns, false, gap,
                                   near, pairs};
        Facing::run(team, in_rows, in_columns);
        team.sync();
        evidence.run(team);
    }

    // Splits obstacles that bend around free floor, and stores the extents of the parts in `last`.
    void straighten(const Team& team, const Contours& of_whole) const {
        const int groups = counts[GROUPS];
        int* before = parts + groups;  // exclusive prefix sum of the extra parts of groups
        const Warp warp(team);
        for (int g = team.rank; g < groups; g += team.size) before[g] = 0;
        if (settings[BEND] > 0) {
            const Contours contours = contours_of(groups, last, pairs);
            contours.join(team, of_whole, number);
            contours.list(team);
            for (int g = warp.index; g < groups; g += warp.count) {
                const int found = straight_parts(warp, g).run() - 1;
                if (warp.lane == 0) before[g] = found;
            }
        }
        team.sync();
        if (warp.index == 0) warp.exclusive_sum(before, groups);
        team.sync();
        const auto name_at = [&](int g) {
            return groups + before[g] < MAX_LABELS ? groups + before[g] : (int)MAX_LABELS;
        };
        if (team.rank == 0) counts[PARTS] = name_at(groups);
        for (int g = warp.index; g < groups; g += warp.count) {
            const int next = name_at(g), found = name_at(g + 1) - next;
            if (warp.lane == 0) parts[g] = found;
            if (!found) continue;
            const int *begin = straight_parts(warp, g).parts, end = last.column_high[g];
            int part = 0;
            for (int c = last.column_low[g] + warp.lane; c <= end; c += warp.size) {
                while (part < found && line_column[start[g] + begin[part + 1]] <= c) ++part;
                part_of[g * columns + c] = part ? next + part - 1 : g;
            }
        }
        team.sync();
        if (counts[PARTS] == groups) return;
        name(team);
        measure(team, last, counts[PARTS]);
    }

    // Replaces the merged surface of each listed cell by its part of an obstacle. Ends in a sync.
    void name(const Team& team) const {
        for (int i = team.rank; i < *listed.count; i += team.size) {
            const int g = number[listed.label[i]];
            listed.label[i] = parts[g] ? part_of[g * columns + listed.cell[i] % columns] : g;
        }
        team.sync();
    }

    StraightParts straight_parts(const Warp& warp, int g) const {
        const int begin = start[g];
        return {warp, line_x + begin, line_y + begin, start[g + 1] - begin, settings[BEND],
                settings[SIDE], settings[SIDE], stack + begin + g, packed + begin + g};
    }

    // Sorts obstacles by distance and removes those that are too small or too far away.
    void order(const Team& team) const {
        const int count = counts[PARTS], wholes = counts[WHOLE];
        // If nothing is split and no width matters, the cells still have the labels of merged surfaces.
        bool named = count > counts[GROUPS];
        if (team.any(width_decides(team, last, count)) && !named) {
            name(team);
            named = true;
        }
        if (named) measure_width(team, last, count);
        for (int l = team.rank; l < count; l += team.size) {
            small[l] = !(is_large(last, l) && last.cells[l] >= settings[MIN_CELLS] &&
                         last.nearest[l] <= settings[FARTHEST]);
        }
        team.sync();
        for (int l = team.rank; l < count; l += team.size) {
            int before = 0;
            for (int other = 0; other < count; ++other) {
                before += !small[other] && is_before(other, l);
            }
            spare[l] = small[l] ? -1 : before;
            if (!small[l]) team.atomic_add(total, 1);
        }
        team.sync();
        for (int l = team.rank; l < wholes; l += team.size) group[l] = spare[number[l]];
        team.sync();
        const int* to = named ? spare : group;
        for (int i = team.rank; i < *listed.count; i += team.size)
            label[listed.cell[i]] = to[listed.label[i]];
        team.sync();
    }

    bool is_before(int one, int other) const {
        const int z_one = last.nearest[one], z_other = last.nearest[other];
        if (z_one != z_other) return z_one < z_other;
        const int x_one = last.leftmost[one], x_other = last.leftmost[other];
        if (x_one != x_other) return x_one < x_other;
        return last.first[one] < last.first[other];
    }
};

} }  // namespace jaxdet
