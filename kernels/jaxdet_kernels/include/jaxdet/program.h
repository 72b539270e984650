// The detection method on a batch of frames: from depth images to records of results.
#pragma once
#include "arena.h"
#include "cells.h"
#include "floor.h"
#include "free.h"
#include "lower_parts.h"
#include "notches.h"
#include "obstacles.h"
#include "outlines.h"
#include "rays.h"
#include "surfaces.h"

#if defined(__CUDA_ARCH__)
#define JAXDET_STEP __forceinline__
#else
#define JAXDET_STEP __attribute__((noinline))  // separate functions compile faster
#endif

namespace jaxdet { namespace {

// Cursor over the header of a buffer; reads sizes and the offsets of arrays one after the other.
struct Header {
    const int* at;

    template <class... Sizes> void sizes(Sizes&... all) { ((all = Team::input(at++)), ...); }
    template <class Base, class... Arrays> void places(Base* base, Arrays*&... all) {
        ((all = (Arrays*)(base + Team::input(at++))), ...);
    }
};

// The named arrays of one frame, in the order of jaxdet/stages/_program.py. Most offsets follow from
// the size of the grid, which is an argument of the kernels: CUDA recomputes them at each use, while
// values read from memory would occupy registers.
struct Frame {
    enum {
        STATIC = 3,   // number of words at the start of the header that only Python reads
        HEADER = 32,  // number of words of the header
        DEPTHS = 65536,
        SLOTS = 128  // MAX_OBSTACLES
    };
    const unsigned short* depth;  // (height, width) depth image
    const int* floors;            // prior, Floor::PRIOR words; its floor frame, FloorFrame::VALUES words
    int* contour;                 // (SLOTS, columns, 2) contours, right and forward

    int rows, columns;  // size of the grid of cells
    int width, side, trees, leaves, aligned;
    int work_words;  // number of words of the intermediate arrays
    // Tables; those of the first line have an entry per depth.
    const int *near, *steps, *limits, *rises, *bows, *drops, *bands;
    const int *surface_settings, *outline_settings, *free_settings, *last, *directions;
    const int *bearings, *ray_directions;
    const float *block_settings, *parameters, *corner_x, *corner_y;
    const FloorSettings* floor_settings;
    const int *rays, *tile_corners, *sines, *feature, *threshold, *value, *obstacle_settings;
    // Intermediate arrays that a step writes for later steps, one value per cell except for `frame`.
    int *frame, *x, *y, *z, *nearest, *right, *forward, *above, *surface, *label;
    unsigned char *keep, *free, *low, *half;
    // The record of results.
    int *floor, *num_surfaces, *has_depth, *num_obstacles;
    int *num_points, *has_vertex, *contour_points;
    int *uv_min, *uv_max, *a, *b, *c, *direction, *bottom_top;
    int *xyz_min, *xyz_max, *xyz_sum, *span, *free_ranges, *free_end, *first_notch;

    Frame(int rows, int columns, const int* tables, const unsigned short* depth, const int* floors,
          int* record, int* contour, int* work)
        : depth(depth), floors(floors), contour(contour), rows(rows), columns(columns) {
        Header header{tables + STATIC};
        header.sizes(width, side, trees, leaves, aligned);
        header.places(tables, corner_x, corner_y, rays, tile_corners, floor_settings, sines, feature, threshold,
                      value, obstacle_settings);
        Arena fixed{(int*)tables + HEADER};
        fixed.take(DEPTHS, near, steps, limits, rises, bows, drops);
        fixed.take(2 * DEPTHS, bands);
        fixed.take(Surfaces::SETTINGS, surface_settings);
        fixed.take(Outlines::SETTINGS, outline_settings);
        fixed.take(FreeFloor::SETTINGS, free_settings);
        fixed.take(2, last);
        fixed.take(2 * Outlines::DIRECTIONS, directions);
        fixed.take((1 << Rays::RATIO_BITS) + 1, bearings);
        fixed.take(4 * Rays::RAYS, ray_directions);
        fixed.take(RayBlocks::SETTINGS, block_settings);
        fixed.take(Projection::PARAMETERS + 2, parameters);
        const int cells = rows * columns;
        Arena handed{work}, found{record};
        handed.take(FloorFrame::VALUES, frame);
        handed.take(cells, x, y, z, nearest, right, forward, above, surface, label);
        handed.take((cells + 3) / 4, keep, free, low, half);
        work_words = handed.used;
        found.take(FoundFrame::RESULTS, floor);
        found.take(1, num_surfaces, has_depth, num_obstacles);
        found.take(SLOTS, num_points, has_vertex, contour_points);
        found.take(2 * SLOTS, uv_min, uv_max, a, b, c, direction, bottom_top);
        found.take(3 * SLOTS, xyz_min, xyz_max);
        found.take(6 * SLOTS, xyz_sum);
        found.take(4 * SLOTS, span);
        found.take(2 * Rays::RAYS, free_ranges);
        found.take(Rays::RAYS, free_end);
        found.take(1, first_notch);
    }

    JAXDET_STEP void find_cells(const Team& team, int*) const {
        CellGrid{depth, width, rows, columns, side, near, rays, x, y, z, nearest}.run(team);
    }

    Floor floor_near(const int* prior, const Team& team, Arena& arena, int* fast) const {
        return {team, floor_settings, sines, prior, rows, columns, arena, fast};
    }
    JAXDET_STEP void find_floor(const Team& team, int* scratch) const {
        JAXDET_SHARED int fast[Floor::SHARED];
        Arena arena{scratch};
        floor_near(floors, team, arena, fast).run(x, y, z, rows, columns, floor);
    }

    JAXDET_STEP void find_frame(const Team& team, int*) const {
        if (team.rank == 0) FoundFrame{{sines}}.run(floor, floors + Floor::PRIOR, frame);
        team.sync();
    }

    JAXDET_STEP void find_surfaces(const Team& team, int* scratch) const {
        Surfaces{rows, columns, x, y, z, frame, steps, limits, rises, surface_settings, right,
                 forward, above, surface, keep, free, low, half, num_surfaces, has_depth, scratch}
            .run(team);
    }

    Obstacles obstacles(int* fast) const {
        const Trees every{feature, threshold, value, trees, leaves,
                          obstacle_settings[Obstacles::OFFSET]};
        return {fast, rows, columns, surface, x, y, z, right, forward, above, free,
                obstacle_settings, every, label, num_obstacles};
    }
    JAXDET_STEP void find_obstacles(const Team& team, int* scratch) const {
        JAXDET_SHARED int fast[Obstacles::FAST];
        Arena arena{scratch};
        Obstacles found = obstacles(fast);
        found.allocate(arena);
        found.run(team);
        LowerParts{rows, columns, half, forward, above, label}.run(team, FloorFrame(frame));
    }

    // Scratch memory of the free-floor step.
    struct FreeParts {
        int *line, *polar, *end, *falls, *start, *stop, *block, *corners;

        FreeParts(int rows, int columns, Arena& arena) {
            arena.take(4 * columns, line, polar);
            arena.take(columns, end, falls);
            arena.take(Rays::RAYS, start, stop, block);
            arena.take(RayBlocks::num_corners(rows, columns), corners);
        }
    };
    JAXDET_STEP void find_free_floor(const Team& team, int* scratch) const {
        Arena arena{scratch};
        const FreeParts parts(rows, columns, arena);
        const int* const of = free_settings;
        const FloorFrame floor_frame(frame);
        FreeFloor by_column{team, rows, columns, of[FreeFloor::NEAREST], of[FreeFloor::FAR],
                            of[FreeFloor::GAP], label, z, right, forward, above, (const bool*)low, bows,
                            drops, parts.line, parts.end, parts.falls, false};
        const Rays found{by_column, bearings, ray_directions, parts.start, parts.stop, parts.block,
                         parts.polar, of[FreeFloor::HALF_TURN]};
        by_column.run(floor_frame);
        const Notches notches{by_column, of, half, parts.polar, parts.start, parts.stop, label,
                              num_obstacles, first_notch};
        if (notches.run()) by_column.run(floor_frame);
        found.begin();
        found.find_points();
        const bool inside = found.is_foot_inside();
        found.add_floor(inside);
        RayBlocks(by_column, of, floor_frame, nearest, rays, tile_corners, block_settings)
            .run(found, parts.corners);
        found.put(inside, free_ranges, free_end);
    }

    // Allocates the outlines of `number` obstacles in the arena, then calls `use` with them.
    template <class Use>
    void with_outlines(const Team& team, int number, Arena& arena, Use use) const {
        const Warp warp(team);
        ObstacleCells cells{team, rows * columns, columns, number, Margins(columns), label, right,
                            forward};
        const CellBoxes boxes{columns, side, corner_x, corner_y, Projection::of(parameters), last,
                              aligned != 0};
        const Measures measures{cells, warp, outline_settings[Outlines::TRIM],
                                outline_settings[Outlines::VERTEX], bands, {x, y, z}, above, boxes,
                                num_points, uv_min, uv_max, xyz_min, xyz_max, xyz_sum, a, b, c,
                                bottom_top, has_vertex};
        Outlines outlines{cells, warp, measures, SLOTS, outline_settings[Outlines::LONG],
                          directions, contour, contour_points, direction, span, num_points,
                          (int)(free_ranges - num_points)};
        outlines.allocate(arena, cells);
        use(outlines);
    }
    JAXDET_STEP void find_outlines(const Team& team, int* scratch) const {
        Arena arena{scratch};
        const int number = *num_obstacles < SLOTS ? *num_obstacles : (int)SLOTS;
        with_outlines(team, number, arena, [](const Outlines& outlines) { outlines.run(); });
    }

    // Returns the largest number of scratch words of any step, computed for the layout on the CPU; the
    // layout on CUDA needs no more words.
    size_t scratch_words(const Team& team) const {
        enum { FLOOR, SURFACES, OBSTACLES, OUTLINES, FREE_FLOOR, ALL };
        Arena of[ALL];
        for (Arena& arena : of) arena = Arena::counting();
        const int prior[Floor::PRIOR] = {};
        floor_near(prior, team, of[FLOOR], nullptr);
        Surfaces::Parts(rows, columns, of[SURFACES]);
        obstacles(nullptr).allocate(of[OBSTACLES]);
        with_outlines(team, 0, of[OUTLINES], [](const Outlines&) {});
        FreeParts(rows, columns, of[FREE_FLOOR]);
        int most = 0;
        for (const Arena& arena : of) most = arena.used > most ? arena.used : most;
        return (size_t)most;
    }
};

// The arrays of a batch: one row of words per frame.
struct Batch {
    const unsigned short* depth;
    const int *floors, *tables;
    int *record, *contour, *work;
    int frames, pixels, record_words, contour_words, work_words, rows, columns;

    enum { FLOOR_WORDS = Floor::PRIOR + FloorFrame::VALUES };

    Frame frame(size_t b, int* own_work) const {
        return {rows, columns, tables, depth + b * pixels, floors + b * FLOOR_WORDS,
                record + b * record_words, contour + b * contour_words, own_work};
    }

    // On CUDA: calls `step` for each frame assigned to this team.
    template <class Step>
    void by_teams(int tid, int teams, int* scratch, size_t words, Step step) const {
        const Team team(tid, 0);
        int* const own = scratch + team.index * words;
        for (int b = team.index; b < frames; b += teams)
            step(frame(b, work + (size_t)b * work_words), team, own);
    }

#if !defined(__CUDA_ARCH__)
    // On the CPU, in one thread: takes frames from the queue and runs steps `first` to `last` on each.
    // The intermediate arrays are in `work` if it has a row per frame, otherwise in `own`, followed by
    // the scratch memory.
    void by_threads(int* next, int first, int last, int* own) const {
        const Team team(0, 0);
        typedef void (Frame::*Step)(const Team&, int*) const;
        const Step steps[] = {&Frame::find_cells, &Frame::find_floor, &Frame::find_frame,
                              &Frame::find_surfaces, &Frame::find_obstacles,
                              &Frame::find_free_floor, &Frame::find_outlines};
        each_frame(next, frames, [&](size_t b) {
            const bool kept = work_words > 1;
            const Frame one = frame(b, kept ? work + b * work_words : own);
            for (int k = first; k <= last; ++k)
                (one.*steps[k])(team, kept ? own : own + one.work_words);
        });
    }
#endif
};

} }  // namespace jaxdet
