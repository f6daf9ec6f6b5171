"""Merkle trees against the published test vectors of Certificate Transparency, and a second formula.

Leaves, roots and proofs are those of github.com/transparency-dev/merkle (proof/verify_test.go). It also gives the wrong proofs to refuse.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import pytest

from planrunner.archive.merkle import (
    EMPTY,
    ProofError,
    complete_nodes,
    consistency_proof,
    inclusion_path,
    leaf_hash,
    require_consistency,
    require_inclusion,
    root_of,
    tree_hash,
)

ENTRIES = [
    bytes.fromhex(text)
    for text in (
        "",
        "00",
        "10",
        "2021",
        "3031",
        "40414243",
        "5051525354555657",
        "606162636465666768696a6b6c6d6e6f",
    )
]
LEAVES = [leaf_hash(entry) for entry in ENTRIES]
ROOTS = [
    bytes.fromhex(text)
    for text in (
        "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
        "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
        "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
        "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
        "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
        "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
        "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
        "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
        "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
    )
]
"""Roots of the first 0, 1, 2 … 8 leaves."""
A = "96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7"
B = "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e"
C = "6b47aaf29ee3c2af9af889bc1fb9254dabd31177f16232dd6aab035ca39bf6e4"
D = "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b"
E = "ca854ea128ed050b41b35ffc1b87b8eb2bde461e9e3b5596ece6b9d5975a0ae0"
F = "0ebc5d3437fbe2db158b9f126a1d118e308181031d0a949f8dededebc558ef6a"
G = "b08693ec2e721597130641e8211e7eedccb4c26413963eee6c1e2ed16ffb1a5f"
INCLUSION = {
    (0, 1): [],
    (0, 8): [A, B, C],
    (5, 8): [D, E, ROOTS[4].hex()],
    (2, 3): [ROOTS[2].hex()],
    (1, 5): [ROOTS[1].hex(), B, D],
}
"""(Index of the leaf, size of the tree) → path."""
CONSISTENCY = {
    (1, 1): [],
    (1, 8): [A, B, C],
    (6, 8): [F, E, ROOTS[4].hex()],
    (2, 5): [B, D],
    (6, 7): [F, G, ROOTS[4].hex()],
}


def hashes(texts: list[str]) -> list[bytes]:
    return [bytes.fromhex(text) for text in texts]


def plain_hash(entries: list[bytes]) -> bytes:
    """The definition of the RFC, written down once more."""
    n = len(entries)
    if n < 2:
        return hashlib.sha256(b"\0" + entries[0] if entries else b"").digest()
    k = max(2**i for i in range(20) if 2**i < n)
    return hashlib.sha256(b"\1" + plain_hash(entries[:k]) + plain_hash(entries[k:])).digest()


def test_roots_of_the_vectors() -> None:
    assert [tree_hash(LEAVES[:n]) for n in range(9)] == ROOTS


def test_roots_agree_with_the_definition_of_the_rfc() -> None:
    entries = [b"%d" % number for number in range(70)]
    for n in range(71):
        assert tree_hash([leaf_hash(entry) for entry in entries[:n]]) == plain_hash(entries[:n])
    nodes = complete_nodes([leaf_hash(entry) for entry in entries])
    assert [root_of(nodes, n) for n in range(71)] == [plain_hash(entries[:n]) for n in range(71)]


@pytest.mark.parametrize("place", INCLUSION)
def test_inclusion_proofs_of_the_vectors(place: tuple[int, int]) -> None:
    index, size = place
    path = hashes(INCLUSION[place])
    assert inclusion_path(index, LEAVES[:size]) == path
    require_inclusion(LEAVES[index], index, size, path, ROOTS[size])
    for wrong in wrong_inclusions(index, size, path):
        with pytest.raises(ProofError):
            require_inclusion(*wrong)


def wrong_inclusions(index: int, size: int, path: list[bytes]) -> Iterator[tuple[bytes, int, int, list[bytes], bytes]]:
    leaf, root = LEAVES[index], ROOTS[size]
    for other in (index - 1, index + 1, index ^ 2):
        yield leaf, other, size, path, root
    for other in (size * 2, size // 2):
        yield leaf, index, other, path, root
    yield b"WrongLeaf", index, size, path, root
    for wrong in (EMPTY, hashlib.sha256(b"other").digest()):
        yield leaf, index, size, path, wrong
    yield from ((leaf, index, size, wrong, root) for wrong in wrong_paths(path, root))


def wrong_paths(path: list[bytes], *more: bytes) -> Iterator[list[bytes]]:
    for extra in (b"", *more):
        yield [*path, extra]
        yield [extra, *path]
    for number, one in enumerate(path):
        yield [*path[:number], bytes([one[0] ^ 8]) + one[1:], *path[number + 1 :]]
    if path:
        yield path[:-1]


@pytest.mark.parametrize("sizes", CONSISTENCY)
def test_consistency_proofs_of_the_vectors(sizes: tuple[int, int]) -> None:
    first, second = sizes
    path = hashes(CONSISTENCY[sizes])
    assert consistency_proof(first, LEAVES[:second]) == path
    require_consistency(first, second, ROOTS[first], ROOTS[second], path)
    if not path:
        return
    roots = ROOTS[first], ROOTS[second]
    wrong = [(one, second, *roots, path) for one in (first - 1, first + 1, first ^ 2)]
    wrong += [(first, other, *roots, path) for other in (second * 2, second // 2)]
    wrong += [(first, second, b"x", roots[1], path), (first, second, roots[0], b"x", path)]
    wrong += [(first, second, roots[1], roots[0], path), (first, second, *roots, [])]
    wrong += [(first, second, *roots, one) for one in wrong_paths(path, *roots, path[0])]
    for one in wrong:
        with pytest.raises(ProofError):
            require_consistency(*one)


def test_every_proof_of_every_small_tree() -> None:
    leaves = [leaf_hash(b"%d" % number) for number in range(33)]
    roots = [tree_hash(leaves[:n]) for n in range(34)]
    for size in range(34):
        for index in range(size):
            require_inclusion(leaves[index], index, size, inclusion_path(index, leaves[:size]), roots[size])
        for first in range(size + 1):
            proof = consistency_proof(first, leaves[:size])
            require_consistency(first, size, roots[first], roots[size], proof)
            if 0 < first < size:
                with pytest.raises(ProofError):
                    require_consistency(first, size, roots[first - 1], roots[size], proof)


def test_trees_that_shrink_or_differ_are_refused() -> None:
    for first, second, one, other in (
        (2, 1, ROOTS[2], ROOTS[1]),
        (1, 1, ROOTS[1], ROOTS[2]),
        (0, 3, ROOTS[1], ROOTS[3]),
    ):
        with pytest.raises(ProofError):
            require_consistency(first, second, one, other, [])
    with pytest.raises(ProofError):
        inclusion_path(3, LEAVES[:3])
    with pytest.raises(ProofError):
        consistency_proof(4, LEAVES[:3])
