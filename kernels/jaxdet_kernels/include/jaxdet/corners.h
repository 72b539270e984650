// Detects the strongest corners of a colour image.
#pragma once
#include "arena.h"
#include "canny.h"
#include "corner_maxima.h"
#include "corner_selection.h"

namespace jaxdet { namespace {

// Settings of Canny and of the corner selection, in the order of jaxdet/stages/paper/_corners.py.
struct CornerSettings {
    enum { LOW, HIGH, LIMIT, QUALITY, COUNT = QUALITY + 2 };
    const int* values;  // (COUNT) settings by index

    // Thresholds of Canny, from -1 to 2047.
    int low() const { return values[LOW]; }
    int high() const { return values[HIGH]; }

    // Square of the minimum distance between corners, rounded up; 0: no minimum.
    int limit() const { return values[LIMIT]; }

    // Minimum strength, as a fraction of the strongest pixel's: a double in two words.
    double quality() const {
        union {
            unsigned long long bits;
            double value;
        } both;
        both.bits = (unsigned)values[QUALITY + 1];
        both.bits = both.bits << 32 | (unsigned)values[QUALITY];
        return both.value;
    }
};

struct Corners {
    typedef unsigned long long Word;

    int height, width;
    CornerSettings settings;
    int slots;

    enum { BLOCKED = 480 * 640 / 32 };  // words of a bitmap that fits in `Shared`

    // Memory shared by a team, used by one stage after the other.
    union Shared {
        Canny::Tile tile;
        CornerMaxima::Shared maxima;
        unsigned blocked[BLOCKED];
    };

    // Scratch memory of a team.
    struct Scratch {
        unsigned *weak, *edges, *mirrored, *blocked;
        int *list, *halves, *strength;
        Word *keys, *other;

        Scratch(Arena& arena, int height, int width) {
            arena.take(height * PixelBits::words(width), weak, edges, blocked, list);
            arena.take(height * CornerMaxima::outer_words(width), mirrored);
            arena.take(height, halves);
            arena.take(CornerMaxima::strengths(height, width), strength);
            arena.take(2 * height * width, keys, other);
        }
    };

    static int scratch_words(int height, int width) {
        Arena arena = Arena::counting();
        Scratch(arena, height, width);
        return arena.used;
    }

    // Writes the columns and rows of corners and their number, at most slots + 1.
    void run(const Team& team, Shared& shared, const unsigned char* color, int* own, int* u_out,
             int* v_out, int* count_out) const {
        Arena arena{own};
        const Scratch scratch(arena, height, width);
        Canny{color, height, width, settings.low(), settings.high(), scratch.weak, scratch.edges}
            .run(team, shared.tile);
        Hysteresis{height, PixelBits::words(width) / 2, (const Word*)scratch.weak,
                   (Word*)scratch.edges}.run(team);
        CornerMaxima::mirror(team, scratch.edges, scratch.mirrored, height, width);
        const int maxima = CornerMaxima{scratch.mirrored, height, width, settings.quality(),
                                        scratch.list, scratch.strength, scratch.keys}
            .run(team, shared.maxima);
        const bool fits = height * PixelBits::words(width) <= BLOCKED;
        const int count = CornerSelection{height, width, settings.limit(), slots, u_out, v_out,
                                          fits ? shared.blocked : scratch.blocked, scratch.halves,
                                          scratch.other}.run(team, scratch.keys, maxima);
        if (team.rank == 0) *count_out = count;
    }
};

} }  // namespace jaxdet
