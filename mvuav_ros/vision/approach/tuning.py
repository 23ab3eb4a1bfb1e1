"""The constants of mode approach: unit, meaning, and the footage that they were chosen on.

Lengths are px of the working image, about 320 px wide, unless a comment says something else. The
tuned half is runs 3 and 5, the cockpit stills of every other video, the country and the forest
road; run 2, the other stills and the motorway were looked at for figures alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class DetectorTuning:
    """Of the whole frame."""

    frozen_frames: int = 50  # equal frames, after which a picture shows nothing: two seconds
    # shares of the height searched for vanishing points without a horizon
    whole_range: tuple[float, float] = (0.03, 0.65)
    range_above: float = -0.4  # share of the height above the picture, up to which likewise
    min_side: int = 48  # px of the frame's shorter side
    # standard deviations from the attitude's horizon, beyond which edges that meet are no runway's.
    # Simulated flights with attitude; right ones are up to 2.5 away
    max_off_attitude: float = 4.0


@dataclass(frozen=True)
class HorizonTuning:
    """Of the horizon, chosen on runs 3 and 5 and the stills of the tuned half."""

    # rad, of the camera's axis by attitude; beyond, the horizon is nowhere near the image
    max_pitch: float = math.radians(80.0)
    min_upside_down: float = 0.3  # cosine between image's down and world's up: beyond 107 deg
    width: int = 80  # px of the small image in which it is looked for without attitude
    height: int = 60  # px, likewise
    slope_step_deg: float = 1.5  # between slopes that are tried
    max_roll_deg: float = 66.0  # of the slopes that are tried
    step_rows: int = 3  # odd; rows above and below, whose difference is a step
    max_step: float = 24.0  # grey levels; more counts as that
    min_strength: float = 3.0  # grey levels of the mean step across a horizon
    # differences of neighbours above a horizon, but for the largest tenth, per step across it.
    # Even ones of 60 simulated flights, 500 to 559, and tuned stills
    max_edges: float = 0.8
    sky_rows: int = 14  # rows above it in which these are measured
    min_sky_rows: int = 1  # of these rows, that must be in view
    # grey levels by which all above it is brighter than as many rows below: 33 and more with sky,
    # up to 22 without. Run 5 and the simulator's flights that look down
    min_contrast: float = 25.0
    column_step: int = 4  # px between the columns of the refinement
    reach: int = 5  # px above and below the expected line
    min_columns: int = 12  # columns of the refinement
    min_agreement: float = 0.55  # share of columns on the line, with which a followed one is kept
    full_period: int = 10  # frames between two looks for the horizon at any slope
    row_cost: float = 0.03  # grey levels per row: of steps alike the upper one


@dataclass(frozen=True)
class LevelsTuning:
    """Of frames that use a part of the grey levels. Runs 3 and 5, in fog and underexposed."""

    bit_frames: int = 8  # of which two must have a brightest pixel of more bits, to believe it
    columns: int = 40  # at least, of those that are looked at
    shares: tuple[float, float] = (2.0, 98.0)  # %, of the values that are below both ends
    min_spread: float = 10.0  # grey levels between both ends: noise alone has 4 to 8
    # likewise, to which less is stretched: whole pictures have 100 and more, magnified land 60
    usual_spread: float = 70.0
    max_gain: float = 6.0
    darkest: float = 40.0  # grey levels of the lower end then
    memory: float = 0.1  # share of a new frame in both ends


@dataclass(frozen=True)
class HazeTuning:
    """Of haze, chosen on runs 3 and 5 as they are, and with half of the contrast 40 rows below."""

    period: int = 6  # frames from one look to the next
    column_step: int = 4  # px between the columns that are looked at
    sky_rows: int = 6  # above the horizon
    min_rows: int = 20  # of land
    first_depth: int = 3  # rows below the horizon, from which on the land is looked at
    darkest: float = 5.0  # %, of a row's pixels that are darker than its dark places
    min_contrast: float = 4.0  # grey levels between the sky and a row of land that is seen
    memory: float = 0.5  # share of a new look, at least
    usual_density: float = 3.0  # rows, of clear flights: 2 to 3.5
    # rows beyond that from which on it is haze: clear flights have 5, magnified by four 7
    min_excess: float = 8.0
    max_gain: float = 6.0  # of what is nearly invisible


@dataclass(frozen=True)
class MotionTuning:
    """Of what moves between frames, and of what stands still. Run 5 and the tuned roads."""

    # px by which a camera may turn between two frames: anyway, and if the whole picture has moved,
    # unlike where it is torn. Runs 2, 3 and 5, shaken, swaying, torn, and half grey
    reaches: tuple[int, int] = (6, 20)
    coarse: tuple[int, int] = (40, 30)  # px, of the whole picture
    max_error_moved: float = 0.95  # of the error without moving it
    min_side: int = 40  # px of the compared part's sides
    max_side: int = 96  # px, likewise
    min_correlation: float = 0.5  # of two parts that show the same
    min_alike: float = 0.1  # likewise, anything in common: noise has up to 0.07, fast turns 0.18
    min_contrast: float = 2.0  # grey levels, deviation of what shows anything: noise has 1 to 2
    max_unlike: int = 3  # images in a row that are left out, as of a camera or a link that fails
    max_corners: int = 150  # corners compared
    corner_distance: float = 5.0  # px between corners
    flow_window: tuple[int, int] = (9, 9)  # px around a corner that are compared
    flow_levels: int = 2  # levels of the pyramid above the finest
    period: int = 6  # frames from one comparison to the next
    max_period: int = 12  # frames after which other corners are taken
    max_still: float = 0.25  # px by which a corner that stands still may seem to have moved
    min_moved: float = 1.2  # px by which the ground moved, before standing still says anything
    min_moving: int = 10  # corners that moved, for a map to be known
    min_inliers: float = 0.6  # share of them that fit one map
    max_residual: float = 1.0  # px by which corners may miss the map
    # Of pixels that stand still: grey levels by which images of the same differ, log odds from
    # which one is overlaid, px around it without evidence, and share of the pixels that a map must
    # explain plainly better than none does, by a logarithm of the ratio of squares. Runs 3 and 5
    # with reticles, tuned stills with digits that change
    pixel_noise: float = 2.0
    min_overlaid: float = 3.0
    beside_overlaid: int = 2
    min_moved_share: float = 0.05
    plain_ratio: float = 1.0
    forgotten: float = 0.1  # share of them lost in a comparison: one wrong map hides nothing
    # Of edges that stand still or move: samples by which the map may be wrong, grey levels by which
    # images of the same differ, widths from an edge to land that should move. Outlines drawn over
    # moving planes; runs 3 and 5
    spare: int = 3
    still_noise: float = 3.0
    beside: float = 0.5
    near_places: int = 8  # along a near end
    near_reach: int = 3  # px above and below it. A drawn runway that stands still
    map_sigma: float = 0.5  # px, of the map where edges are
    still_weight: float = 4.0  # log odds of standing still per logarithm of the ratio of squares
    still_doubt: float = 0.3  # that ratio, which wrong maps reach
    most_still_odds: float = 3.0  # log odds of one comparison
    least_still: float = -4.0  # log odds of a track, at first and at least
    most_still: float = 12.0  # likewise, at most


@dataclass(frozen=True)
class EdgesTuning:
    """Of edges measured on the frame itself. Run 3 and the simulator's flights."""

    max_rows: int = 40  # rows in which an edge is measured
    correlated_rows: float = 3.0  # neighbouring rows that err alike
    sample: float = 0.5  # px between samples across an edge
    reach: float = 0.35  # widths searched on both sides of the expected edge
    min_reach: float = 3.0  # px, likewise
    max_reach: float = 8.0  # px, likewise
    stripes_reach: float = 0.04  # widths, where side stripes were seen: these are 0.03 wide
    # widths, likewise, of a strip that was found on a coarse image: 2 px of its level
    far_reach: float = 0.12
    min_step_share: float = 0.25  # of the strip's contrast: a row with less supports no edge
    widths_per_step: float = 12.0  # width of the strip over the length of a step
    min_seen: float = 0.5  # share of a line's rows that must be on the frame; fewer count as that
    usual_rank: float = 0.15  # rank, from the worst, of the line whose votes are usual
    min_contrast: float = 1.5  # grey levels: less gives no direction
    clear_contrast: float = 12.0  # grey levels that are plain to see
    colour_contrast: float = 30.0  # opponent colours' levels between pavement and grass by day
    paint_share: float = 0.3  # of it, by which stripes are brighter than all; sharpening gives 0.25
    # px of the frame over which a stripe's side rises before a sharp camera, and share of what is
    # more by which it may be off at the far end. Grey ones of 60 simulated flights, 500 to 559
    usual_blur: float = 2.5
    blur_share: float = 0.6
    memory: float = 0.05  # share of a new frame in the contrast. Simulated slabs and S-turns
    region: int = 5  # samples across an edge over those of its outside, or its inside


@dataclass(frozen=True)
class LinesTuning:
    """Of the lines along a runway's sides, in widths of the runway. Runs 3, 5 and variants."""

    same: float = 0.1  # between two lines along an edge, and between like gaps of both sides
    # of the clearest line's clearness: markings in run 3 have 0.6 to 0.85, shoulders' lines
    # in run 5 0.9
    clear_share: float = 0.85
    clear_doubt: float = 0.05  # its doubt
    away_cost: float = 4.0  # log odds lost per width from where the strips' mean has the edge
    away_from_colour_cost: float = 20.0  # log odds, likewise where colour shows the edge
    shoulder_cost: float = 4.0  # log odds lost by the outer of two, with like ones opposite
    step: float = 0.02  # between samples across an edge
    reach: float = 0.5  # of the samples on both sides of an expected edge
    max_away: float = 0.32  # between a line's middle and the expected edge
    half_widths: tuple[float, float] = (0.06, 0.1)  # of lines
    rows: int = 24  # sampled between the far and the near end
    max_turned: float = 0.24  # between a line's places at the far and at the near end
    turned_cost: float = 1.67  # share of a line's clearness lost per width between its ends
    beyond: float = 0.16  # of a line's middle, up to which its outer side is looked for
    apart: float = 0.12  # between lines that are not one
    most: int = 4  # lines along an edge that are compared
    noise: float = 0.5  # grey levels of ridges that are taken to be everywhere
    max_width: float = 90.0  # px of the near end, beyond which threshold markings are distinguished
    min_clearness: float = 1.2  # of the fainter line, in usual ridges of the place
    min_depth: float = 2.0  # grey levels by which it becomes darker outside of a line
    # of the smaller depth in the larger, of both sides: 99 % of the frames of runs 3 and 5 have
    # 0.56 and more, joints of slabs higher over concrete (seeds 348 to 371) 0.41 to 0.47
    min_alike: float = 0.5
    # share of the rows in which it does so: runs 3 and 5 have 0.5, mere texture 0.1 to 0.22
    min_support: float = 0.25
    max_ridge: float = 4.0  # usual ridges: more counts as that, so that one lamp is not a line


@dataclass(frozen=True)
class ShouldersTuning:
    """Of paved shoulders; lengths are widths of the runway. Run 3 and its variants alone."""

    rows: int = 32  # sampled
    # px of the near end: a narrower runway's side lines look like shoulders in run 5
    min_width: float = 45.0
    first_row: float = 0.3  # share of the way from the far end: before, a shoulder is too narrow
    step: float = 0.01  # between samples
    inside: float = 0.02  # sampled inside of the edge
    beyond: float = 0.3  # sampled outside of the edge
    window: float = 2.0  # px of the means whose difference is a step: the blur of run 3
    min_step: float = 0.034  # share of the mean brightness
    # of the edge's own step: run 3's shoulders have 0.19 and more, land in simulated flights 0.1
    min_step_share: float = 0.15
    min_clearness: float = 0.0064  # share of the mean brightness, beside what is between


@dataclass(frozen=True)
class SearchTuning:
    """Of the search for runways, and of their rows and features."""

    step_reach: int = 2  # px on each side over which a step is averaged; the blur of edges in run 3
    # px from a painted line's middle to where it must be darker: lines of 1 to 3 px, as in run 3
    ridge_reaches: tuple[int, int] = (2, 3)
    # width and height over which texture is averaged: far more than lines, far less than fields
    texture_window: tuple[int, int] = (61, 15)
    # grey levels of texture that smooth land has at least: noise and JPEG error of run 3 and stills
    brightness_floor: float = 2.0
    colour_floor: float = 2.5  # likewise, of both opponent colours
    # textures at which a step or a ridge counts most, so that one bright lamp is not a runway
    most_evidence: float = 4.0
    # of evidence of brightness, blue against yellow, red against green, and paint
    weights: tuple[float, float, float, float] = (1.0, 0.8, 0.8, 1.2)
    row_bias: float = 0.9  # evidence of a row that speaks neither for nor against a strip
    # px below the vanishing point of near ends that are searched on one level of the pyramid; the
    # next level has twice these
    depths: tuple[int, ...] = (10, 14, 20, 28)
    first_row: float = 0.4  # share of the near end's depth at which the compared part begins
    last_first_row: float = 0.65  # the same, at most, of what meets above; flights that look down
    min_inside: float = 0.6  # share of these rows in which an edge is not beside the image
    samples: int = 8  # rows compared in the search
    edges_kept: int = 7  # strongest edges through one vanishing point that are paired
    steepest: float = 1.8  # columns per row of the flattest edge searched
    narrowest: float = 6.0  # px; a narrower near end says nothing
    widest: float = 1.5  # width over camera height of what is searched (a flare is followed only)
    widest_above: float = 3.6  # the same of edges that meet above; flights that look down
    farthest_aside: float = 1.2  # lateral offset over width
    candidates: int = 60  # kept on the finest level of the pyramid; half as many on the others
    attitude_reach: float = 10.0  # px searched about a horizon from attitude, which is good to 6
    attitude_sigma: float = 6.0  # px, standard deviation of that horizon
    horizon_reach: tuple[float, float] = (20.0, 60.0)  # px above and below a horizon in the image
    min_score: float = 0.5  # textures per row of a pair of edges
    max_pairs: int = 4  # strips of one row of vanishing points
    align_rows: int = 14  # rows compared when edges are moved
    align_rounds: int = 2  # of moving one edge, then the other
    align_cost: float = 0.02  # textures lost per px moved
    around_shifts: int = 5  # places of each edge tried on either side of a strip
    around_shift: float = 0.11  # widths between them
    min_around_shift: float = 0.75  # px between them
    min_around_width: float = 0.45  # widths of the narrowest strip tried around another
    max_around_width: float = 2.2  # widths of the widest
    min_slope_gap: float = 0.1  # columns per row between both edges of an aligned strip
    min_depth: float = 4.0  # px of an aligned strip
    max_depth: float = 60.0  # px, likewise
    max_deeper: float = 1.5  # depths before; on a finer level that may be more than ``max_depth``
    levels: int = 4  # of the pyramid
    finest_aligned: int = 1  # level on which edges found on coarser ones are placed at last
    min_part: int = 12  # px of the sides of the part around strips
    max_level_depth: float = 28.0  # px of a level: deeper near ends are measured on the next one
    profile_rows: int = 44  # below vanishing points: near ends of 28 px, and half as much again
    max_gain: float = 5.0  # textures of a row; more counts as that
    first_depth: float = 1.5  # px below the vanishing point, from which rows count
    min_row_width: float = 2.0  # px of a row that counts
    slack: float = 1e-09  # of sums of evidence, which are rounded
    min_sky_row: float = -1.0  # of the vanishing point, from which what is above it is in view


@dataclass(frozen=True)
class StripTuning:
    """Of strips and of the Kalman filter on their edges."""

    side_margin: float = 1.2  # widths beside strips that are needed to describe them
    min_side_margin: float = 36.0  # px, likewise
    margin_above: float = 18.0  # px above the vanishing point
    depth_below: float = 2.7  # depths of the near end
    points: int = 12  # of a mean's edge
    min_width: float = 5.0  # px of the near end: less cannot be distinguished from specks in clouds
    top_row: float = 6.0  # px: of what meets above it ``min_below_top`` must be in view. Run 2, cut
    min_below_top: float = 8.0  # px; less is a letter at the top. Text on the motorway
    max_above: float = 1.0  # heights of the image by which the vanishing point may lie above it
    point_sigma: float = 0.7  # px of one edge point
    yaw_sigma: float = 1.2  # px per frame
    pitch_sigma: float = 0.8  # px per frame
    slope_sigma: float = 0.006  # columns per row and frame of an edge
    slope_share_sigma: float = 0.02  # share of the strip's slope per frame
    end_memory: float = 0.6  # share of the newest frame in where the ends are


@dataclass(frozen=True)
class TrackTuning:
    """Of one runway that is followed, and how likely. Runs 3 and 5 and the simulator's flights."""

    max_strips: int = 10  # weighed
    max_odds_below: float = -9.0  # log odds under the best strip's, below which one does not count
    same_share: float = 0.06  # widths between edges of strips that are the same
    same_px: float = 0.6  # px, likewise
    # px of width, and by what log odds are divided there, as frames err alike
    hot: tuple[float, float] = (20.0, 2.5)
    # likewise: where strips are as near as the tolerance, their middle is right more often
    cold: tuple[float, float] = (40.0, 1.0)
    memory: float = 0.06  # share of a weighed frame in what a track remembers
    young: int = 5  # frames in which a track is weighed every time
    dim_odds: float = -1.5  # log odds below which it is not worth that
    min_tolerance: float = 3.0  # px by which an edge may be wrong
    tolerance_share: float = 0.05  # widths, likewise
    wide: float = 18.0  # px of the near end, from which edges are clearer steps than lines' sides
    min_support: float = 0.25  # of the edges, 0 to 1, from which that holds
    # share of a weighing that shows shoulders, of one that does not, and of one in which too little
    # of what lies beside is in the picture. Simulated slabs before a camera that looks down
    shoulder_memory: tuple[float, float, float] = (0.8, 0.4, 0.12)
    # what of it makes them possible and certain. Run 3
    shoulder_range: tuple[float, float] = (0.3, 0.6)
    min_length: float = 5.0  # widths from end to end, of which the shortest runways have ten
    miss_memory: float = 0.15  # share of a frame that does not show it in what a track remembers
    missed_odds: float = -4.0  # log odds of a weighing in which nothing is there
    lock_width: float = 24.0  # px from which edges alone are followed: near by all is straight
    lock_age: int = 20  # frames, likewise
    lock_confidence: float = 0.55  # likewise. Simulated flights that look down, the country road
    plain_support: float = 0.5  # of steps that need no strips beside them. Flights that look down
    lock_share: float = 0.9  # probability that the edges are steps or lines, likewise
    unlock_share: float = 0.5  # the same, below which it is no longer
    first_kinds: tuple[float, float, float] = (0.6, 0.2, 0.2)  # of strips, steps and lines
    kind_leave: float = 0.02  # probability that the kind of edge becomes another one
    kind_weight: float = 0.3  # of one frame's log odds, as frames err alike
    lines_seen: tuple[float, float] = (-2.0, 3.0)  # log odds of lines that are missing, or seen
    support_odds: float = 6.0  # log odds of steps per support
    colour_odds: float = 3.0  # log odds of steps that colour shows
    colour_width: float = 38.0  # px up to which that holds: later lines show the edges better
    steps_away: float = -2.0  # log odds of steps that are not where the strips are
    # logarithm of px from the vanishing point to the near end: run 5 has up to 48 px, nine tenths
    # of run 3 up to 53, simulated flights over a runway 90 and more
    min_near_by: float = math.log(60.0)
    max_deviations: float = 4.0  # standard deviations: features beyond say no more
    least_odds: float = -6.0  # log odds of a track; fewer count as that
    most_odds: float = 8.0  # likewise, more
    min_agreement: float = 0.05  # that counts as none
    known_frames: int = 50  # frames after which a track is known


@dataclass(frozen=True)
class TrackerTuning:
    """Of several strips followed at a time, and the search for others."""

    max_tracks: int = 3  # followed at a time
    chunk: int = 8  # rows of vanishing points searched in one frame
    period_first: int = 2  # frames from one share of the search to the next without a runway
    period_later: int = 4  # the same once all was searched
    scene_frames: int = 24  # for which the image as a whole is taken to stay alike
    max_weighed: int = 14  # strips of a share of the search, and around the mean of a track
    best_period: int = 6  # frames from one weighing of the best track to the next
    others_period: int = 12  # the same of others
    period_certain: int = 24  # the same of others, and of the search, with a runway
    min_odds: float = -5.0  # log odds of a track
    min_start_odds: float = -3.0  # log odds of a candidate
    # log odds lost by what lies above a horizon that the image has shown for longer. Text in run 3
    above_horizon_odds: float = 1.0
    switch_margin: float = 0.7  # log odds by which another track must be better than the one shown
    max_below_best: float = 6.0  # log odds below the best candidate


@dataclass(frozen=True)
class RoadTuning:
    """Of roads' lanes and pipelines. The country and the forest road."""

    first_depth: float = 4.0  # px below the vanishing point, from which rows count
    farther: float = 0.7  # depths of the far end, from which on edges are looked for
    ceiling: float = 4.0  # floors: the contrast that counts most
    highest: float = 0.3  # share of the height, below which lines may meet: the camera looks ahead
    lowest: float = 0.72  # share of the image's height above which they may
    meeting_reach: float = 8.0  # px from a known horizon, at which they may
    paint_reach: int = 6  # px: paint is brighter than what is so far to its left and to its right
    paint_contrast: float = 12.0  # grey levels
    usual_steps: float = 90.0  # percentile of steps, above which they may be a pipeline's edges
    min_votes: int = 14  # of a line
    max_lines: int = 24  # that are paired
    max_strips: int = 16  # candidates of a search
    flattest: float = 4.0  # columns per row
    same_place: float = 6.0  # px on the lowest row between lines that are the same
    same_slope: float = 0.15  # columns per row, likewise
    memory: float = 0.15  # share of the newest frame in what a track remembers
    horizon_sigma: float = 4.0  # px of the vanishing point about the horizon
    support_range: float = 0.25  # above the target's, at which support is full
    min_sharp: float = 0.2  # share of that
    convincing: float = 7.0  # sum of quality above ``start_score``, with which a track is shown
    certain: float = 10.0  # likewise, above which more does not count
    min_age: int = 8  # frames until then
    fades: float = 0.8  # factor of the confidence for a frame in which it is not seen
    max_tracks: int = 4  # followed at a time
    switch_margin: float = 0.26  # log odds by which another track must be better than that shown
    search_period: int = 4  # frames from one search to the next while a track is shown
    max_wider: float = 1.5  # widths of one strip over another, up to which both may be the same
    max_started: int = 6  # candidates of a search that are tried
    min_land: int = 8  # rows


@dataclass(frozen=True)
class GuidanceTuning:
    """Of the pose's covariance."""

    edge_bias: float = 0.12  # px of the frame by which an edge's points err alike, at either end
    # px of the frame, on both edges inwards or outwards alike: side stripes, defocus
    width_bias: float = 0.16
    # standard deviation of how far points of lines lie outside, over that. Simulated, in grey
    outside_share: float = 0.2
    min_spread: float = 0.05  # px of the frame
    near_sigma: float = 1.0  # px of the working image: of the near end's row
    beginning_sigma: float = 10.0  # m: markings and overruns blur where the pavement begins
    slope_sigma: float = math.radians(0.06)  # rad, of the horizon's slope
    bank_sigma: float = math.radians(10.0)  # rad, of a slope of 0 where no horizon is known
    # Half widths of the image by which edges meet off a horizon that has the right slope
    max_usual_away: float = 0.012
    # rad in the slope, 1 sigma, per half width that they meet farther off: haze, clouds, hills, and
    # borders of fields. Even ones of 60 simulated flights, 500 to 559
    slope_share: float = 0.8
    stated_slope_share: float = 0.2  # likewise, of an attitude
    jacobian_step: float = 0.0001  # px, or rad


DETECTOR = DetectorTuning()
HORIZON = HorizonTuning()
MOTION = MotionTuning()
LEVELS = LevelsTuning()
HAZE = HazeTuning()
EDGES = EdgesTuning()
LINES = LinesTuning()
SHOULDERS = ShouldersTuning()
SEARCH = SearchTuning()
STRIP = StripTuning()
TRACK = TrackTuning()
TRACKER = TrackerTuning()
ROAD = RoadTuning()
GUIDANCE = GuidanceTuning()
