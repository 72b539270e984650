// Shape of the floor ahead of its plane: flat, a ramp, or a step. Twin of
// jaxdet/reference/_floor_ahead.py, which documents the constants.
#pragma once
#include "floor_ramp.h"
#include "floor_step.h"

namespace jaxdet { namespace {

struct FloorOutlook {
    enum { MIN_GAIN = 5, OVER_RAMP = 2, ALIKE = 3 };
    FloorRamps ramps;
    FloorSteps steps;
    // Whether there is a prior; if there is one, the largest height above the floor that the camera may
    // have [depth units].
    bool has_prior;
    int farthest;
    // Scratch, one word per plane: upper bound of the votes of a ramp ahead of the plane.
    int* most_ramp;

    // Chooses among distinct planes, each alone or with a ramp or a step ahead of it. If a plane with a
    // ramp or a step has clearly more votes than any plane alone, returns this plane, and writes the
    // ramp or step to `out`. Otherwise returns the first plane, and `out` has no ramp and no step.
    FloorPlane run(const Team& team, const FloorPlane* planes, int count, FloorAhead& out) const {
        const int none = -0x7fffffff;
        int most_alone = none, best_plane = 0, best_votes = none;
        unsigned tried = 0;
        out = {};
        for (int n = 0; n < count; n++) {
            if (team.rank == 0) most_ramp[n] = none;
            ramps.sort(team, planes[n]);
            ramps.limits(team, ramps.fine());
            const int alone = ramps.flat()[ramps.runs()];
            most_alone = alone > most_alone ? alone : most_alone;
            ramps.limit(team, ramps.fine(), most_ramp + n);
            team.sync();
            bool is_new = true;
            for (int k = 0; k < n; k++)
                if (tried >> k & 1) is_new = is_new && !are_alike(planes[n], planes[k]);
            if (!is_new) continue;
            tried |= 1u << n;
            FloorAhead found;
            int votes;
            const int deeper = has_prior ? farthest - planes[n].height : 0;
            if (!steps.step(team, best_votes + 1, deeper, found, votes)) continue;
            best_votes = votes;
            best_plane = n;
            out = found;
        }
        const int gain = most_alone > 0 ? MIN_GAIN : 0;
        const long long least = (100LL + gain) * most_alone;
        const int needed = (int)ramps.angles.quotient(least, 100) + 1;
        if (best_votes < needed) {
            best_votes = needed - 1;
            best_plane = 0;
            out = {};
        } else {
            // The number of votes from which a ramp is preferred to the step.
            const int percent = 100 + OVER_RAMP, votes = best_votes;
            const int enough = votes > 0 ? (100 * votes + percent - 1) / percent : votes;
            best_votes = (enough > needed ? enough : needed) - 1;
        }
        int sorted = count - 1;
        for (int n = 0; n < count; n++) {
            if (most_ramp[n] <= best_votes) continue;
            if (n != sorted) ramps.sort(team, planes[n]);
            sorted = n;
            FloorAhead found;
            int votes;
            if (ramps.ramp(team, best_votes + 1, found, votes)) {
                best_votes = votes;
                best_plane = n;
                out = found;
            }
            team.sync();
        }
        return planes[best_plane];
    }

    // Whether two planes are too similar to try steps with both.
    bool are_alike(FloorPlane a, FloorPlane b) const {
        const auto differ = [](int a, int b, int most) { return a - b > most || b - a > most; };
        return !differ(a.pitch, b.pitch, ALIKE) && !differ(a.roll, b.roll, ALIKE) &&
               !differ(a.height, b.height, ramps.settings->alike);
    }
};

} }  // namespace jaxdet
