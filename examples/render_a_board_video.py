"""A camera's video of a moving board: python examples/render_a_board_video.py OUT.mp4 [SEED].

Its lens is drawn from the seed; what a calibration should find is printed.
"""

import sys

import av
import cv2
import numpy as np

COLUMNS, ROWS, SQUARE = 9, 6, 0.03  # Inner corners, and the side of a square, m
TEXEL = 40  # px of the board's picture along a square
CORNER_NOISE = 0.2  # px, of each corner in each frame
PAUSE, STEPS = 4, 5  # Frames for which the board is held still, and from one place to the next


def picture():
    """The printed board with its white margin of one square."""
    squares = np.add.outer(np.arange(ROWS + 3), np.arange(COLUMNS + 3)) % 2 * 215.0 + 20
    squares[[0, -1]], squares[:, [0, -1]] = 235, 235
    return np.kron(squares, np.ones((TEXEL, TEXEL))).astype(np.uint8)


def lens(rng, model='plumb_bob', size=(640, 480)):
    """A camera matrix and coefficients."""
    low, high = (0.45, 0.6) if model == 'equidistant' else (0.7, 1.4)
    focal = rng.uniform(low, high) * size[0]
    centre = np.array(size) / 2 - 0.5 + rng.uniform(-12, 12, 2)
    matrix = np.array([(focal, 0, centre[0]), (0, focal * rng.uniform(0.995, 1.005), centre[1])])
    edge = 0.5 * size[0] / focal
    if model == 'equidistant':
        d = rng.uniform((-0.03, -0.01, -0.003, -0.001), (0.03, 0.01, 0.003, 0.001))
    else:
        radial = rng.uniform(-0.16, 0.05) / edge**2
        d = np.array((radial, -0.25 * radial / edge**2, *rng.uniform(-5e-4, 5e-4, 2), 0.0))
    return np.vstack((matrix, (0, 0, 1))), d


class Renderer:
    """Draws a board as a lens sees it: by a pinhole camera first, then bent by the lens."""

    def __init__(self, matrix, d, model, size):
        self.board, self.size = picture(), size
        # Twice as fine as the image: (0, 0) is the centre of a pixel on both sides.
        fine = np.stack(np.meshgrid(*(np.arange(2 * side) / 2 - 0.25 for side in size)), -1)
        undistort = cv2.fisheye.undistortPoints if model == 'equidistant' else cv2.undistortPoints
        rays = undistort(fine.reshape(-1, 1, 2), matrix, d).reshape(fine.shape)
        # A pinhole image that holds all rays, as fine in its middle as the camera's.
        self.focal, self.shift = 2 * matrix[0, 0], 2 * matrix[0, 0] * np.abs(rays).max()
        self.bend = (rays * self.focal + self.shift).astype(np.float32)
        self.side = int(2 * self.shift) + 2

    def draw(self, moments, noise, ground):
        """One image of the mean of some board poses; the corners move by (rows, columns, 2) px."""
        y, x = np.indices(self.board.shape, np.float32)
        moved = np.pad(noise, ((2, 2), (2, 2), (0, 0)), mode='edge').astype(np.float32) * TEXEL
        moved = cv2.remap(moved, (x + 0.5) / TEXEL, (y + 0.5) / TEXEL, cv2.INTER_LINEAR)
        board = cv2.remap(
            self.board,
            x - moved[..., 0],
            y - moved[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        pinhole = np.array([(self.focal, 0, self.shift), (0, self.focal, self.shift), (0, 0, 1)])
        texels = np.array(
            [(1, 0, 0.5 - 2 * TEXEL), (0, 1, 0.5 - 2 * TEXEL), (0, 0, TEXEL / SQUARE)]
        )
        image = np.zeros((2 * self.size[1], 2 * self.size[0]), np.float32)
        for rotation, translation in moments:
            plane = np.column_stack((rotation[:, 0], rotation[:, 1], translation))
            whole = cv2.warpPerspective(
                board, pinhole @ plane @ texels, (self.side, self.side), borderValue=(ground,)
            )
            image += cv2.remap(whole, self.bend, None, cv2.INTER_LINEAR)
        return cv2.resize(image / len(moments), self.size, interpolation=cv2.INTER_AREA)


def poses(rng, matrix, places, size=(640, 480)):
    """Rotation vectors and places of the board's middle: held still, moved on, frame by frame."""
    stops = []
    for _ in range(places):
        direction = rng.uniform(0, 2 * np.pi)
        tilt = np.radians(rng.uniform(15, 45))
        turn = (tilt * np.cos(direction), tilt * np.sin(direction), rng.uniform(-0.4, 0.4))
        depth = matrix[0, 0] / size[0] * rng.uniform(0.35, 0.6)
        beside = rng.uniform(-0.25, 0.25, 2) * np.array(size) / matrix[0, 0] * depth
        stops.append((*turn, *beside, depth))
    for here, there in zip(stops, stops[1:] + stops[:1], strict=True):
        yield from [(np.array(here), np.zeros(6))] * PAUSE
        step = (np.array(there) - here) / STEPS
        yield from [(here + number * step, step) for number in range(1, STEPS)]


def frames(seed, model='plumb_bob', places=40, size=(640, 480), exposure=0.4):
    """The camera matrix, the coefficients, and an iterator over grey images."""
    rng = np.random.default_rng(seed)
    matrix, d = lens(rng, model, size)
    renderer = Renderer(matrix, d, model, size)
    ground = rng.uniform(60, 160)
    middle = np.array(((COLUMNS - 1) / 2 * SQUARE, (ROWS - 1) / 2 * SQUARE, 0))

    def images():
        for pose, step in poses(rng, matrix, places, size):
            scale = pose[5] / matrix[0, 0] / SQUARE  # Squares per pixel
            noise = rng.normal(0, CORNER_NOISE * scale, (ROWS, COLUMNS, 2))
            parts = np.linspace(-0.5, 0.5, 5) if step.any() else (0.0,)
            moments = []
            for moved in (pose + part * exposure * step for part in parts):
                rotation = cv2.Rodrigues(moved[:3])[0]
                moments.append((rotation, moved[3:] - rotation @ middle))
            image = cv2.GaussianBlur(renderer.draw(moments, noise, ground), (0, 0), 0.6)
            yield np.clip(image + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)

    return matrix, d, images()


def write(path, images):
    """An MP4 file."""
    with av.open(str(path), 'w') as container:
        stream = None
        for image in images:
            if stream is None:
                stream = container.add_stream(
                    'libx264', rate=15, options={'crf': '14', 'preset': 'veryfast'}
                )
                stream.height, stream.width = image.shape
                stream.pix_fmt = 'yuv420p'
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format='gray')):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


if __name__ == '__main__':
    if len(sys.argv) < 2:
        sys.exit('usage: python examples/render_a_board_video.py OUT.mp4 [SEED]')
    matrix, d, images = frames(int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    write(sys.argv[1], images)
    print(f'true focal length {matrix[0, 0]:.1f} px, {matrix[1, 1]:.1f} px')
    print(f'true principal point {matrix[0, 2]:.1f}, {matrix[1, 2]:.1f}')
    print('true distortion', *(f'{value:.4f}' for value in d))
