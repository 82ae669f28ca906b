"""Kernels of pictures drawn on a device: rays of tiles, the edges among their hits, and `shade`'s
colours, by Warp.

A launch works on W slots of C places each: a slot holds some tiles of one picture, a place one of
their pixels, or one of the rays through an edge's pixel.
"""

from __future__ import annotations

import warp as wp

NO_RAY = -2
SKY = -1
AWAY = 1e9  # where rays of places without a pixel begin [m]: they meet no box of a scene
# as `mjtLightType` has them
DIRECTIONAL = 1
SPOT = 0


@wp.struct
class Tile:
    """A tile of a picture: its first place, its pixels with the rim by which edges are found (left,
    top, right, bottom), and the wanted.
    """

    start: int
    grown: wp.vec4i
    wanted: wp.vec4i


@wp.struct
class SlotView:
    """Pose of the camera of a slot, and the number of its tiles."""

    origin: wp.vec3
    R: wp.mat33
    tiles: int


@wp.struct
class SceneLook:
    """What all worlds of a scene share: colours, textures with their mipmaps one after another, the
    sky, fixed properties of lights.
    """

    rgb: wp.array(dtype=wp.vec3)
    glow: wp.array(dtype=float)
    box: wp.array(dtype=int)
    half: wp.array(dtype=wp.vec3)
    texture: wp.array(dtype=int)  # of what is printed on a geom; -1 for none
    times: wp.array(dtype=wp.vec2)
    uniform: wp.array(dtype=int)
    gloss: wp.array(dtype=wp.vec2)  # specular and 128 shininess; 0 where nothing is mirrored
    samples: wp.array(dtype=int)  # of a texture seen aslant
    level: wp.array(dtype=wp.vec2i)  # of a texture: its first level, and the number of levels
    size: wp.array(dtype=wp.vec3i)  # of a level: start in `texels`, width, height
    texels: wp.array(dtype=wp.vec3ub)
    elevation: wp.array(dtype=float)
    tint: wp.array(dtype=wp.vec3)
    light_type: wp.array(dtype=int)
    attenuation: wp.array(dtype=wp.vec3)
    cone: wp.array(dtype=wp.vec2)  # cosine of the cutoff, exponent


@wp.struct
class Lamps:
    """The lights of each world now, shape (W, lights)."""

    place: wp.array2d(dtype=wp.vec3)
    along: wp.array2d(dtype=wp.vec3)
    ambient: wp.array2d(dtype=wp.vec3)
    diffuse: wp.array2d(dtype=wp.vec3)
    specular: wp.array2d(dtype=wp.vec3)


@wp.struct
class Rays:
    """Rays of all places, shape (W, C), and what they hit."""

    origin: wp.array2d(dtype=wp.vec3)
    ray: wp.array2d(dtype=wp.vec3)
    apart: wp.array2d(dtype=float)
    distance: wp.array2d(dtype=float)
    geom: wp.array2d(dtype=int)
    normal: wp.array2d(dtype=wp.vec3)


@wp.struct
class TileSlots:
    """What is in each slot, shapes (W,) and (W, tiles)."""

    views: wp.array(dtype=SlotView)
    tiles: wp.array2d(dtype=Tile)


@wp.struct
class Lens:
    """The pixels of a picture: how many are in a row, the ray through the centre of each, and the
    angle to the next.
    """

    width: int
    rays: wp.array(dtype=wp.vec3)
    angles: wp.array(dtype=float)


@wp.struct
class Edges:
    """The pixels at edges: how many in each slot (W,), and their places (W, C)."""

    count: wp.array(dtype=int)
    place: wp.array2d(dtype=int)


@wp.struct
class DrawnWorlds:
    """All that is shaded: what the worlds share, their lights, the poses of their geoms (W, geoms),
    and the rays.
    """

    look: SceneLook
    lamps: Lamps
    xpos: wp.array2d(dtype=wp.vec3)
    xmat: wp.array2d(dtype=wp.mat33)
    rays: Rays


@wp.struct
class Hit:
    """A point on a geom, the ray there and the normal, and how wide a pixel is there."""

    geom: int
    point: wp.vec3
    ray: wp.vec3
    normal: wp.vec3
    across: float


@wp.func
def _tile(slots: TileSlots, w: int, j: int) -> int:
    """Number of the tile of place j; -1 for a place beyond all tiles."""
    for k in range(slots.views[w].tiles):
        tile = slots.tiles[w, k]
        grown = tile.grown
        if j < tile.start + (grown[2] - grown[0]) * (grown[3] - grown[1]):
            return k
    return -1


@wp.func
def _pixel(slots: TileSlots, w: int, j: int, width: int) -> int:
    """Number of the pixel of place j in the picture; -1 for a place beyond all tiles."""
    k = _tile(slots, w, j)
    if k < 0:
        return -1
    grown = slots.tiles[w, k].grown
    within = j - slots.tiles[w, k].start
    columns = grown[2] - grown[0]
    return (grown[1] + within // columns) * width + grown[0] + within % columns


@wp.func
def _aim(rays: Rays, w: int, j: int, view: SlotView, ray: wp.vec3, apart: float):
    """Point place j along a ray in the camera's frame; away from everything where the lens has
    none.
    """
    if wp.isnan(ray[0]):
        rays.origin[w, j] = wp.vec3(AWAY, AWAY, AWAY)
        rays.ray[w, j] = wp.vec3(1.0, 0.0, 0.0)
    else:
        rays.origin[w, j] = view.origin
        rays.ray[w, j] = view.R @ ray
    rays.apart[w, j] = apart


@wp.kernel
def aim(slots: TileSlots, lens: Lens, rays: Rays):
    """The ray through the centre of each pixel."""
    w, j = wp.tid()
    pixel = _pixel(slots, w, j, lens.width)
    if pixel < 0:
        _aim(rays, w, j, slots.views[w], wp.vec3(wp.nan, wp.nan, wp.nan), 0.0)
    else:
        _aim(rays, w, j, slots.views[w], lens.rays[pixel], lens.angles[pixel])


@wp.func
def _shown(rays: Rays, w: int, j: int) -> int:
    """Number of the geom that place j shows, SKY for none, NO_RAY where the lens has no ray."""
    if rays.origin[w, j][0] > 0.5 * AWAY:
        return NO_RAY
    return rays.geom[w, j]


@wp.kernel
def edges(slots: TileSlots, rays: Rays, found: Edges):
    """The wanted places of each tile with a neighbour, of eight, that shows another geom: how many,
    and which.
    """
    w, j = wp.tid()
    k = _tile(slots, w, j)
    if k >= 0:
        tile = slots.tiles[w, k]
        columns = tile.grown[2] - tile.grown[0]
        rows = tile.grown[3] - tile.grown[1]
        row = (j - tile.start) // columns
        column = (j - tile.start) % columns
        u = tile.grown[0] + column
        v = tile.grown[1] + row
        wanted = tile.wanted
        if u >= wanted[0] and u < wanted[2] and v >= wanted[1] and v < wanted[3]:
            own = _shown(rays, w, j)
            other = int(0)
            for dv in range(-1, 2):
                above = wp.clamp(row + dv, 0, rows - 1) * columns
                for du in range(-1, 2):
                    near = above + wp.clamp(column + du, 0, columns - 1)
                    if _shown(rays, w, tile.start + near) != own:
                        other = 1
            if other == 1:
                found.place[w, wp.atomic_add(found.count, w, 1)] = j


@wp.func
def _edge(count: int, first: int, j: int, n: int) -> int:
    """The number of the edge whose ray is at place j, of n rays each; -1 for none."""
    edge = (first + j) // n
    if edge >= count:
        return -1
    return edge


@wp.kernel
def aim_within(
    slots: TileSlots,
    lens: Lens,
    within: wp.array2d(dtype=wp.vec3),
    found: Edges,
    first: int,
    rays: Rays,
):
    """The n rays within each pixel at an edge, from the ray `first` on. within: (pixels, n)."""
    w, j = wp.tid()
    n = within.shape[1]
    edge = _edge(found.count[w], first, j, n)
    if edge < 0:
        _aim(rays, w, j, slots.views[w], wp.vec3(wp.nan, wp.nan, wp.nan), 0.0)
    else:
        pixel = _pixel(slots, w, found.place[w, edge], lens.width)
        apart = lens.angles[pixel] / wp.sqrt(float(n))
        _aim(rays, w, j, slots.views[w], within[pixel, (first + j) % n], apart)


@wp.func
def _between(look: SceneLook, level: int, place: wp.vec2) -> wp.vec3:
    """Linear interpolation between the four texels round a place of a level, which repeats itself
    beyond its edges.
    """
    size = look.size[level]
    u = place[0] * float(size[1]) - 0.5
    v = place[1] * float(size[2]) - 0.5
    left = wp.floor(u)
    top = wp.floor(v)
    across = u - left
    down = v - top
    total = wp.vec3(0.0, 0.0, 0.0)
    for i in range(2):
        for k in range(2):
            column = (int(left) + k) % size[1]
            row = (int(top) + i) % size[2]
            if column < 0:
                column += size[1]
            if row < 0:
                row += size[2]
            texel = look.texels[size[0] + row * size[1] + column]
            share = wp.where(k == 1, across, 1.0 - across) * wp.where(i == 1, down, 1.0 - down)
            total += share * wp.vec3(float(texel[0]), float(texel[1]), float(texel[2]))
    return total / 255.0


@wp.func
def _texel(look: SceneLook, texture: int, place: wp.vec2, texels: float) -> wp.vec3:
    """A texture at a place, linear between the two levels whose texels are next to a pixel's size;
    see `shade.Mipmap.at`.
    """
    at = wp.vec2(place[0] - wp.floor(place[0]), place[1] - wp.floor(place[1]))
    level = look.level[texture]
    height = wp.clamp(wp.log2(wp.max(texels, 1.0e-9)), 0.0, float(level[1] - 1))
    fine = int(height)
    part = height - float(fine)
    colour = _between(look, level[0] + fine, at)
    if part > 0.0:
        colour = (1.0 - part) * colour + part * _between(look, level[0] + fine + 1, at)
    return colour


@wp.func
def _on_face(v: wp.vec3, i: int, j: int, edges: wp.vec2, times: wp.vec2) -> wp.vec2:
    """A vector in a geom's frame along the axes i and j of a face, as shares of its texture."""
    return wp.vec2(v[i] / edges[0] * times[0], -v[j] / edges[1] * times[1])


@wp.func
def _mean_along(
    look: SceneLook,
    g: int,
    place: wp.vec2,
    first: wp.vec2,
    second: wp.vec2,
    pixels: wp.vec2,
) -> wp.vec3:
    """The mean of texels along the longer side of what a pixel covers (first, second), at most as
    many as the geom's texture is sampled with.
    """
    texture = look.texture[g]
    long = wp.length(wp.cw_mul(first, pixels))
    short = wp.length(wp.cw_mul(second, pixels))
    along = first
    if short > long:
        along = second
        long = short
        short = wp.length(wp.cw_mul(first, pixels))
    samples = wp.clamp(int(wp.ceil(long / wp.max(short, 1.0e-9) - 0.01)), 1, look.samples[g])
    texels = wp.max(long / float(samples), short)
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(samples):
        share = (float(k) + 0.5) / float(samples) - 0.5
        total += _texel(look, texture, place + along * share, texels)
    return total / float(samples)


@wp.func
def _face(look: SceneLook, g: int, normal: wp.vec3) -> int:
    """The axis across which a face of a geom is, by the normal in its frame; of a plane z."""
    if look.box[g] == 0:
        return 2
    if wp.abs(normal[2]) > wp.max(wp.abs(normal[0]), wp.abs(normal[1])):
        return 2
    if wp.abs(normal[1]) > wp.abs(normal[0]):
        return 1
    return 0


@wp.func
def _print(look: SceneLook, hit: Hit, x: wp.vec3, R: wp.mat33) -> wp.vec3:
    """The texture of a plane or a box with the pose x, R; see `shade.Paint._print`."""
    g = hit.geom
    ray = hit.ray
    normal = hit.normal
    across = hit.across
    turned = wp.transpose(R)
    local = turned @ (hit.point - x)
    n = turned @ normal
    half = look.half[g]
    face = _face(look, g, n)
    size = wp.vec3(1.0, 1.0, 1.0)
    for k in range(3):
        if half[k] > 0.0:
            size[k] = half[k]
    times = look.times[g]
    if look.uniform[g] == 1:
        times = wp.vec2(times[0] * size[0], times[1] * size[1])
    begins = wp.vec2(0.5, 0.5)
    for k in range(2):
        if half[k] > 0.0:
            begins[k] = 0.5 * times[k]
    i = wp.where(face == 0, 1, 0)
    j = wp.where(face == 2, 1, 2)
    edges = wp.vec2(2.0 * size[i], 2.0 * size[j])
    place = _on_face(local, i, j, edges, times) + begins
    texture = look.texture[g]
    whole = look.size[look.level[texture][0]]
    pixels = wp.vec2(float(whole[1]), float(whole[2]))
    cosine = wp.max(wp.abs(wp.dot(ray, normal)), 1.0e-6)
    if look.samples[g] == 1:
        wide = times[0] * pixels[0] / edges[0]
        high = times[1] * pixels[1] / edges[1]
        return _texel(look, texture, place, across / cosine * wp.max(wide, high))
    shadow = ray - wp.dot(ray, normal) * normal
    # seen at a right angle: any direction on the face will do; single floats give no less
    if wp.length(shadow) < 1.0e-6:
        shadow = wp.vec3(R[0, i], R[1, i], R[2, i])
    shadow = wp.normalize(shadow)
    first = _on_face(turned @ (shadow * (across / cosine)), i, j, edges, times)
    second = _on_face(turned @ (wp.cross(normal, shadow) * across), i, j, edges, times)
    return _mean_along(look, g, place, first, second, pixels)


@wp.func
def _share(look: SceneLook, lamps: Lamps, w: int, i: int, to: wp.vec3, far: float) -> float:
    """What share of light i, which has a place, gets to a point from which it is `far` away along
    `to`.
    """
    a = look.attenuation[i]
    share = 1.0 / wp.max(a[0] + a[1] * far + a[2] * far * far, 1.0e-9)
    if look.light_type[i] == SPOT:
        along = wp.clamp(-wp.dot(to, lamps.along[w, i]), 0.0, 1.0)
        if along < look.cone[i][0]:
            return 0.0
        share *= wp.pow(along, look.cone[i][1])
    return share


@wp.func
def _sky(look: SceneLook, up: float) -> wp.vec3:
    """The sky at the sine of an elevation, linear between those that are known."""
    last = look.elevation.shape[0] - 1
    if up <= look.elevation[0]:
        return look.tint[0]
    if up >= look.elevation[last]:
        return look.tint[last]
    low = int(0)
    high = int(last)
    while high - low > 1:
        middle = (low + high) // 2
        if look.elevation[middle] <= up:
            low = middle
        else:
            high = middle
    part = (up - look.elevation[low]) / (look.elevation[high] - look.elevation[low])
    return (1.0 - part) * look.tint[low] + part * look.tint[high]


@wp.func
def _colour(world: DrawnWorlds, w: int, j: int) -> wp.vec3:
    """The colour of what a ray hits, from 0 to 1; see `shade.Paint.colours`."""
    look = world.look
    lamps = world.lamps
    rays = world.rays
    g = rays.geom[w, j]
    ray = rays.ray[w, j]
    distance = rays.distance[w, j]
    normal = rays.normal[w, j]
    if g == SKY:
        return _sky(look, ray[2])
    point = rays.origin[w, j] + ray * distance
    glow = look.glow[g]
    gloss = look.gloss[g]
    light = wp.vec3(glow, glow, glow)
    mirrored = wp.vec3(0.0, 0.0, 0.0)
    for i in range(look.light_type.shape[0]):
        to = -lamps.along[w, i]
        share = float(1.0)
        if look.light_type[i] != DIRECTIONAL:
            way = lamps.place[w, i] - point
            far = wp.max(wp.length(way), 1.0e-9)
            to = way / far
            share = _share(look, lamps, w, i, to, far)
        facing = wp.dot(to, normal)
        light += share * (lamps.ambient[w, i] + wp.max(facing, 0.0) * lamps.diffuse[w, i])
        if gloss[0] > 0.0 and facing > 0.0:
            half = wp.normalize(to - ray)
            shine = wp.pow(wp.clamp(wp.dot(half, normal), 0.0, 1.0), gloss[1])
            mirrored += gloss[0] * share * shine * lamps.specular[w, i]
    colour = wp.min(wp.cw_mul(light, look.rgb[g]), wp.vec3(1.0, 1.0, 1.0))
    if look.texture[g] >= 0:
        hit = Hit()
        hit.geom = g
        hit.point = point
        hit.ray = ray
        hit.normal = normal
        hit.across = rays.apart[w, j] * distance
        colour = wp.cw_mul(colour, _print(look, hit, world.xpos[w, g], world.xmat[w, g]))
    return wp.min(colour + mirrored, wp.vec3(1.0, 1.0, 1.0))


@wp.func
def _grey(colour: float) -> int:
    return int(255.0 * colour + 0.5)


@wp.kernel
def shade(world: DrawnWorlds, out: wp.array2d(dtype=wp.vec3ub)):
    """The grey levels of all places."""
    w, j = wp.tid()
    colour = wp.vec3(0.0, 0.0, 0.0)
    if _shown(world.rays, w, j) != NO_RAY:
        colour = _colour(world, w, j)
    grey = wp.vec3ub()
    for channel in range(3):
        grey[channel] = wp.uint8(_grey(colour[channel]))
    out[w, j] = grey


@wp.kernel
def add_up(world: DrawnWorlds, found: Edges, first: int, n: int, total: wp.array3d(dtype=int)):
    """Add the grey levels of the rays within the pixels at edges to those of their pixel: whole
    numbers, whose order does not count.
    """
    w, j = wp.tid()
    edge = _edge(found.count[w], first, j, n)
    if edge >= 0 and _shown(world.rays, w, j) != NO_RAY:
        colour = _colour(world, w, j)
        for channel in range(3):
            wp.atomic_add(total, w, edge, channel, _grey(colour[channel]))


@wp.kernel
def smooth(found: Edges, n: int, total: wp.array3d(dtype=int), out: wp.array2d(dtype=wp.vec3ub)):
    """The means of the rays within the pixels at edges, rounded, in place of the ray through their
    centre.
    """
    w, edge = wp.tid()
    if edge < found.count[w]:
        mean = wp.vec3ub()
        for channel in range(3):
            mean[channel] = wp.uint8((2 * total[w, edge, channel] + n) // (2 * n))
        out[w, found.place[w, edge]] = mean
