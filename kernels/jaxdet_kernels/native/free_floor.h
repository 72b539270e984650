// How far the floor is seen in each column of cells, and what ends it. Twin of
// jaxdet/reference/_free.py.
#pragma once
#include "team.h"

struct FreeFloor {
    enum { FAR, GAP, SETTINGS };
    enum { UNKNOWN, OBSTACLE, DROP, RANGE };
    enum {
        // So many measured cells one after the other are a drop lower than the last floor.
        RUN = 3,
        // Columns on both sides of one that drops, more than half of which must drop too.
        BESIDE = 10,
        LARGEST = 0x7fffffff,
        DEPTHS = 65536
    };

    // What is known of a column while one goes through its cells.
    struct Column {
        // The obstacle that is nearest and its row, or the range and -1.
        int limit, nearest;
        // Rows where the floor begins and where it has come to, -1 = none yet.
        int first, last;
        // Of the last cell of the floor.
        int forward, height;
        // Whether the floor has ended, and whether it drops there, -1 = not looked at yet.
        int ended, drops;
    };
    enum { COLUMN_WORDS = 8 };

    const Team& team;
    int rows, columns, far, gap;
    const int *label, *z, *right, *forward, *height;
    const bool* low;
    const int *bows, *drops;  // (DEPTHS,), by z
    int *line_out, *end_out;
    Column* state;  // by column

    explicit FreeFloor(const Team& team) : team(team) {}

    void run() const {
#if defined(__CUDA_ARCH__)
        // A thread a column.
        for (int c = team.rank; c < columns; c += team.size) {
            Column column = before();
            for (int row = 0; row < rows; ++row) meet(column, row, c);
            for (int row = rows - 1; row >= 0 && !column.ended; --row) follow(column, row, c);
            put(column, c);
            state[c] = column;
        }
#else
        // Row by row, as the cells lie in memory.
        for (int c = 0; c < columns; ++c) state[c] = before();
        for (int row = 0; row < rows; ++row)
            for (int c = 0; c < columns; ++c) meet(state[c], row, c);
        for (int row = rows - 1; row >= 0; --row)
            for (int c = 0; c < columns; ++c)
                if (!state[c].ended) follow(state[c], row, c);
        for (int c = 0; c < columns; ++c) put(state[c], c);
#endif
        team.sync();
        for (int c = team.rank; c < columns; c += team.size) {
            int beside = 0;
            for (int other = c - BESIDE; other <= c + BESIDE; ++other)
                beside += other >= 0 && other < columns && state[other].drops > 0;
            if (end_out[c] == DROP && beside <= BESIDE) end_out[c] = UNKNOWN;
        }
        team.sync();
    }

    Column before() const { return {LARGEST, -1, -1, -1, 0, 0, 0, -1}; }

    // Looks for the nearest obstacle, from the top row down.
    void meet(Column& column, int row, int c) const {
        const int k = row * columns + c;
        if (label[k] < 0 || (column.nearest >= 0 && forward[k] >= column.limit)) return;
        column.limit = forward[k];
        column.nearest = row;
    }

    // Goes on with the floor, from the bottom row up.
    void follow(Column& column, int row, int c) const {
        const int k = row * columns + c;
        if (!low[k]) return;
        const int ahead = forward[k], limit = column.nearest < 0 ? far : column.limit;
        if (ahead >= limit || z[k] > far || height[k] < -bows[z[k]]) return;
        if (column.first < 0) {
            column.first = row;
        } else if (ahead - column.forward > gap) {
            column.ended = 1;
            return;
        } else if (column.height - height[k] > drops[z[k]]) {
            if (column.drops < 0) column.drops = falls(column, c);
            column.ended = column.drops;
            return;
        }
        column.last = row;
        column.forward = ahead;
        column.height = height[k];
        column.drops = -1;
    }

    // Whether the next RUN measured cells up a column are a drop lower, and lie flat.
    int falls(const Column& column, int c) const {
        int found = 0, before_height = 0, before_forward = 0;
        for (int row = column.last - 1; row >= 0; --row) {
            const int k = row * columns + c;
            if (label[k] >= 0) return 0;
            if (!low[k]) continue;
            if (column.height - height[k] <= drops[z[k]]) return 0;
            const int rise = height[k] - before_height, run = forward[k] - before_forward;
            if (found > 0 && (rise < 0 ? -rise : rise) >= (run < 0 ? -run : run)) return 0;
            if (++found == RUN) return 1;
            before_height = height[k];
            before_forward = forward[k];
        }
        return 0;
    }

    // Where the free floor of a column begins and ends, but for drops that are too narrow.
    void put(Column& column, int c) const {
        const int nearest = column.nearest, last = column.last;
        const bool blocked = nearest >= 0, seen = column.first >= 0;
        if (seen && column.drops < 0) column.drops = falls(column, c);
        const int limit = blocked ? column.limit : far;
        const bool falls_off = column.drops > 0, close = seen && limit - column.forward <= gap;
        const bool up_to = blocked && (!seen || (close && !falls_off));
        put_place(0, seen ? column.first : nearest, c);
        put_place(1, up_to ? nearest : last, c);
        end_out[c] = falls_off ? DROP : up_to ? OBSTACLE : close ? RANGE : UNKNOWN;
    }

    void put_place(int end, int row, int c) const {
        int* place = line_out + 4 * c + 2 * end;
        place[0] = row < 0 ? 0 : right[row * columns + c];
        place[1] = row < 0 ? 0 : forward[row * columns + c];
    }
};
