"""Computes the Merkle tree of a log that only grows, with tree heads, inclusion proofs and consistency proofs (RFC 9162, section
2.1).

The symbols of RFC 9162 are used: MTH is the hash of a tree, PATH is an inclusion proof, and PROOF is a consistency proof. Hashes
are SHA-256.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

Hashes = Sequence[bytes]
EMPTY = hashlib.sha256(b"").digest()
"""Root hash of a tree without leaves."""


class ProofError(ValueError):
    """Reports that a proof does not fit the tree. The message gives the reason."""


def leaf_hash(entry: bytes) -> bytes:
    """Returns the hash of a leaf of a Merkle tree. The prefix 00 of the hashed data distinguishes leaves from nodes (RFC 9162,
    2.1.1)."""
    return hashlib.sha256(b"\0" + entry).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    return hashlib.sha256(b"\1" + left + right).digest()


def tree_hash(leaves: Hashes) -> bytes:
    """Returns the hash MTH of a Merkle tree whose leaves have these hashes (RFC 9162, 2.1.1)."""
    if not leaves:
        return EMPTY
    level = list(leaves)
    while len(level) > 1:  # a last node without a partner moves up unchanged, which gives the tree of the RFC
        paired = [node_hash(level[i], level[i + 1]) for i in range(0, len(level) - 1, 2)]
        level = paired + level[len(paired) * 2 :]
    return level[0]


def complete_nodes(leaves: Hashes) -> list[list[bytes]]:
    """Returns the hashes of all complete subtrees, which have 1, 2, 4 … leaves. They are grouped by height, as `root_of` needs
    them."""
    levels = [list(leaves)]
    while len(below := levels[-1]) > 1:
        levels.append([node_hash(below[i], below[i + 1]) for i in range(0, len(below) - 1, 2)])
    return levels


def root_of(levels: Sequence[Hashes], size: int) -> bytes:
    """Returns the hash MTH of the tree of the first `size` leaves, computed from the result of `complete_nodes`. The computing time
    grows with the logarithm of the size."""
    root, end = None, size
    for height, level in enumerate(
        levels
    ):  # from the smallest complete subtree on the right to the largest on the left
        if end >> height & 1:
            node = level[(end >> height) - 1]
            root = node if root is None else node_hash(node, root)
            end -= 1 << height
    return EMPTY if root is None else root


def inclusion_path(index: int, leaves: Hashes) -> list[bytes]:
    """Returns the inclusion proof PATH(index, leaves): the hashes that lead from a leaf to the root (RFC 9162, 2.1.3.1). The index
    counts from 0. Raises `ProofError` if there is no such leaf."""
    if not 0 <= index < len(leaves):
        raise ProofError(f"the tree has no leaf {index}")
    n = len(leaves)
    if n == 1:
        return []
    k = _split(n)
    if index < k:
        return [*inclusion_path(index, leaves[:k]), tree_hash(leaves[k:])]
    return [*inclusion_path(index - k, leaves[k:]), tree_hash(leaves[:k])]


def consistency_proof(size: int, leaves: Hashes) -> list[bytes]:
    """Returns the consistency proof PROOF(size, leaves), which shows that the tree of the first `size` leaves is a part of the tree
    of all leaves (RFC 9162, 2.1.4.1). The proof is empty for size 0. Raises `ProofError` if there are fewer leaves."""
    if not 0 <= size <= len(leaves):
        raise ProofError(f"the tree has fewer than {size} leaves")
    return _subproof(size, leaves, whole=True) if 0 < size < len(leaves) else []


def _subproof(m: int, leaves: Hashes, *, whole: bool) -> list[bytes]:
    """Returns the list SUBPROOF(m, leaves, b) of RFC 9162, 2.1.4.1. `whole`: the argument b, which is True if the verifier knows
    the hash of the tree of the first m leaves."""
    n = len(leaves)
    if m == n:
        return [] if whole else [tree_hash(leaves)]
    k = _split(n)
    if m <= k:
        return [*_subproof(m, leaves[:k], whole=whole), tree_hash(leaves[k:])]
    return [*_subproof(m - k, leaves[k:], whole=False), tree_hash(leaves[:k])]


def require_inclusion(leaf: bytes, index: int, size: int, path: Hashes, root: bytes) -> None:
    """Verifies an inclusion proof (2.1.3.2). `leaf`: hash of the leaf. Raises `ProofError` if the proof does not fit the tree."""
    if not 0 <= index < size:
        raise ProofError(f"a tree of size {size} has no leaf {index}")
    fn, sn, r = index, size - 1, leaf
    for p in path:
        if sn == 0:
            raise ProofError("the proof is too long")
        if fn & 1 or fn == sn:
            r = node_hash(p, r)
            while not (fn & 1 or fn == 0):
                fn, sn = fn >> 1, sn >> 1
        else:
            r = node_hash(r, p)
        fn, sn = fn >> 1, sn >> 1
    if sn != 0:
        raise ProofError("the proof is too short")
    if r != root:
        raise ProofError("the proof leads to another root")


def require_consistency(first: int, second: int, first_hash: bytes, second_hash: bytes, path: Hashes) -> None:
    """Verifies that the tree of size `second` was made by appending leaves to the tree of size `first` (2.1.4.2). Raises
    `ProofError` if the proof does not fit the trees."""
    if not 0 <= first <= second:
        raise ProofError("the second tree is smaller than the first")
    if first in (0, second):
        if path:
            raise ProofError("the proof is too long")
        if first == second and first_hash != second_hash:
            raise ProofError("trees of the same size have different roots")
        if first == 0 and first_hash != EMPTY:
            raise ProofError("the root of the first tree is not that of an empty tree")
        return
    if not path:
        raise ProofError("the proof is too short")
    rest = list(path)
    if first & (first - 1) == 0:  # a complete tree, whose hash the verifier knows
        rest.insert(0, first_hash)
    fn, sn = first - 1, second - 1
    while fn & 1:
        fn, sn = fn >> 1, sn >> 1
    fr = sr = rest[0]
    for c in rest[1:]:
        if sn == 0:
            raise ProofError("the proof is too long")
        if fn & 1 or fn == sn:
            fr, sr = node_hash(c, fr), node_hash(c, sr)
            while not (fn & 1 or fn == 0):
                fn, sn = fn >> 1, sn >> 1
        else:
            sr = node_hash(sr, c)
        fn, sn = fn >> 1, sn >> 1
    if sn != 0:
        raise ProofError("the proof is too short")
    if fr != first_hash:
        raise ProofError("the proof does not lead to the root of the first tree")
    if sr != second_hash:
        raise ProofError("the proof does not lead to the root of the second tree")


def _split(n: int) -> int:
    """Returns the largest power of two smaller than n."""
    return 1 << (n - 1).bit_length() - 1
