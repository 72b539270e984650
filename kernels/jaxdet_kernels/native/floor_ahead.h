// How a floor goes on ahead: flat, as a ramp, or lower after a step.
// Twin of jaxdet/reference/_floor_ahead.py; the constants are its.
#pragma once
#include "floor_ramp.h"
#include "floor_step.h"

struct FloorOutlook {
    enum { MIN_GAIN = 5 };
    FloorRamps ramps;
    FloorSteps steps;
    // Whether steps are tried, and how far below the camera its floor may be.
    bool may_step;
    int farthest;
    // Scratch: a word a plane each.
    int *most_ramp, *most_step;

    // The plane, with a ramp or a step where clearly more cells speak for that than for any plane.
    // Planes are different ones; the first is taken where there is neither.
    FloorPlane run(const Team& team, const FloorPlane* planes, int count, FloorAhead& out) const {
        const int none = -0x7fffffff;
        int most_alone = none;
        for (int n = 0; n < count; n++) {
            if (team.rank == 0) {
                most_ramp[n] = none;
                most_step[n] = 0;
            }
            ramps.sort(team, planes[n]);
            ramps.limits(team, ramps.fine());
            const int votes = ramps.flat()[ramps.runs()];
            most_alone = votes > most_alone ? votes : most_alone;
            ramps.limit(team, ramps.fine(), most_ramp + n);
            if (may_step) steps.limit(team, most_step + n);
            team.sync();
        }
        const int gain = most_alone > 0 ? MIN_GAIN : 0;
        const long long least = (100LL + gain) * most_alone;
        const int needed = (int)ramps.angles.quotient(least, 100) + 1;
        int best_plane = 0, best_votes = needed - 1, sorted = count - 1;
        out = {};
        for (int n = 0; n < count && may_step; n++) {
            if (most_step[n] <= best_votes) continue;
            if (n != sorted) ramps.sort(team, planes[n]);
            sorted = n;
            FloorAhead found;
            int votes;
            const int deeper = farthest - planes[n].height;
            if (!steps.step(team, best_votes + 1, deeper, found, votes)) continue;
            best_votes = votes;
            best_plane = n;
            out = found;
        }
        // Of as many votes those for a ramp win.
        if (out.drop) best_votes--;
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
};
