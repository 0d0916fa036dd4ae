"""Which photos are compared with which: functions of what is known of them. Photos are numbered, and a pair is (i, j), i < j."""

import numpy as np

# Squared length of a descriptor of COLMAP. Products of such are whole numbers below 2**24, which 32-bit floats have exactly:
# the same photos give the same pairs, whatever adds them up, in whatever order.
LENGTH_2 = 512.0 * 512.0
# Of two features that look alike, the better one has to be so much better (a ratio of squared distances).
RATIO_2 = 0.64
# So many photos are compared with one at once.
BLOCK = 64
METRES_A_DEGREE = 111_320.0
# Positions of phones are some ten metres off.
BLUR_M = 10.0


def all_pairs(count):
    return {(i, j) for i in range(count) for j in range(i + 1, count)}


def pairs_in_order(count, neighbours):
    """Each photo with its neighbours, and with those at distances of powers of two."""
    powers = [1 << power for power in range(count.bit_length()) if 1 << power > neighbours]
    return {(i, i + distance) for distance in [*range(1, neighbours + 1), *powers] for i in range(count - distance)}


def strongest(scales, descriptors, count):
    """The descriptors of the `count` largest features; where there are fewer, the rest is 0."""
    found = descriptors[np.argsort(-np.asarray(scales), kind="stable")[:count]]
    return np.concatenate([found, np.zeros((count - len(found), descriptors.shape[1]), descriptors.dtype)])


def likeness(features):
    """How many features of two photos look alike, for each two. `features` are [photos, features, 128] bytes.

    Large features are few and are seen from afar, so some hundred of them tell whether two photos show the same things
    (Wu, Towards linear-time incremental structure from motion, 2013).
    """
    count = len(features)
    alike = np.zeros((count, count), np.int64)
    for i in range(count - 1):
        own = features[i].astype(np.float32)
        own = own[own.any(axis=1)]
        for start in range(i + 1, count, BLOCK):
            others = features[start : start + BLOCK]
            alike[i, start : start + BLOCK] = alike_features(own, others.astype(np.float32))
    return alike + alike.T


def alike_features(own, others):
    """Of how many features in `own` each of `others` has one that is much more alike than its second best."""
    products = (own @ others.reshape(-1, own.shape[1]).T).reshape(len(own), *others.shape[:2])
    best_at = products.argmax(axis=2)[..., None]
    best = np.take_along_axis(products, best_at, axis=2)[..., 0]
    np.put_along_axis(products, best_at, -1.0, axis=2)
    second = products.max(axis=2)
    return (LENGTH_2 - best < RATIO_2 * (LENGTH_2 - second)).sum(axis=0)


def nearest(closeness, count):
    """Each photo with the `count` that are closest to it; of equally close ones, the first."""
    closeness = closeness.astype(np.float64)
    np.fill_diagonal(closeness, -np.inf)
    order = np.argsort(-closeness, axis=1, kind="stable")[:, : min(count, len(closeness) - 1)]
    return {(min(i, int(j)), max(i, int(j))) for i, row in enumerate(order) for j in row}


def is_walk(alike, count):
    """Whether most photos are among the `count` that are most alike to the one before: their order is that of a walk."""
    near = nearest(alike, count)
    followed = sum((i, i + 1) in near for i in range(len(alike) - 1))
    return 2 * followed > len(alike) - 1


def closeness_of_places(degrees):
    """Minus the distance of each two photos, m, by latitude and longitude; None where that tells nothing."""
    if not np.isfinite(degrees).all():
        return None
    metres = (degrees - degrees[0]) * METRES_A_DEGREE
    metres[:, 1] *= np.cos(np.radians(degrees[0, 0]))
    if metres.std(axis=0).max() < BLUR_M:
        return None
    return -np.linalg.norm(metres[:, None] - metres[None], axis=2)


def pairs_with(closeness, some, others, count):
    """Each of `some` photos with the `count` of `others` that are closest to it."""
    pairs = set()
    for i in some:
        order = sorted(others, key=lambda j: (-closeness[i, j], j))
        pairs |= {(min(i, j), max(i, j)) for j in order[:count] if i != j}
    return pairs
