"""The jobs that a batch can do to each stack."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields

from clrelight.batch.verb import Verb, parameters_of
from clrelight.errors import InputError


def _of_folders() -> set[str]:
    from clrelight.ingest import read_folder

    return parameters_of(read_folder)


def _of_methods() -> set[str]:
    from clrelight.fit import method_class, method_ids

    return _fields_of(map(method_class, method_ids()))


def _of_codecs() -> set[str]:
    from clrelight.codec import codec_class, codec_ids

    return _fields_of(map(codec_class, codec_ids())) - {"byte_budget"}


def _fields_of(kinds: Iterable[type]) -> set[str]:
    return {each.name for kind in kinds for each in fields(kind)}


def find_verb(name: str) -> Verb:
    """Return the verb of a name; InputError lists them."""
    for each in _OF_TILES:
        if each.id == name:
            return each
    if name not in VERBS:
        raise InputError(f"there is no job {name!r} for batches; there are {', '.join(VERBS)}")
    return VERBS[name]


_EVERY = (
    Verb(
        "pack",
        "clrelight.jobs.pack:pack",
        "photographs to one small file that can be relit",
        ".h5",
        ("stack",),
        takes_folders=True,
        reads=("lights", "mask"),
        writes=("keep_stack",),
        more=_of_folders,
    ),
    Verb(
        "ingest",
        "clrelight.jobs.ingest:ingest",
        "photographs to a stack",
        ".h5",
        (),
        takes_folders=True,
        reads=("lights", "mask"),
        more=_of_folders,
    ),
    Verb(
        "fit",
        "clrelight.jobs.fit:fit",
        "a stack to its coefficients",
        ".h5",
        ("stack",),
        writes=("confidence",),
        more=_of_methods,
    ),
    Verb(
        "encode",
        "clrelight.jobs.encode:encode",
        "a fit to a small file",
        ".h5",
        ("fit", "tiles"),
        reads=("stack",),
        more=_of_codecs,
    ),
    Verb("decode", "clrelight.jobs.decode:decode", "a small file to a fit", ".h5", ("encoded",)),
    Verb(
        "unpack",
        "clrelight.jobs.unpack:unpack",
        "a small file to photographs",
        "",
        ("encoded",),
        reads=("lights",),
    ),
    Verb(
        "relight",
        "clrelight.jobs.relight:relight",
        "a fit or a small file to a picture under a light",
        ".png",
        ("fit", "tiles", "encoded"),
        endings=(".exr", ".hdr", ".tif", ".jpg"),
        reads=("light", "lights"),
        writes_many=True,
    ),
    Verb(
        "export",
        "clrelight.jobs.export:export",
        "a fit or a small file to textures",
        "",
        ("fit", "tiles", "encoded"),
        endings=(".dds",),
    ),
    Verb(
        "normals",
        "clrelight.jobs.variation.normals:normals",
        "a stack to its normals",
        ".exr",
        ("stack",),
        endings=(".png", ".tif", ".tiff"),
        writes=("albedo", "confidence", "height", "ply"),
    ),
    Verb(
        "bench",
        "clrelight.batch.bench:bench",
        "a stack to a table of fits and codecs",
        ".h5",
        ("stack",),
    ),
    Verb(
        "psnr",
        "clrelight.jobs.measure:measure",
        "a fit or a small file beside its photographs",
        "",
        ("fit", "tiles", "encoded"),
        reads=("stack",),
        is_measure=True,
    ),
    Verb(
        "find-lights",
        "clrelight.jobs.variation.find_lights:find_lights",
        "photographs to their lights",
        ".lp",
        ("stack",),
        takes_folders=True,
        reads=("normals", "albedo", "mask"),
        writes=("csv", "picture"),
    ),
    Verb(
        "import",
        "clrelight.jobs.archives:import_archive",
        "another viewer's file to a stack",
        ".h5",
        (),
        files=(".ptm", ".rti"),
    ),
    Verb(
        "transfer",
        "clrelight.jobs.surface.transfer:transfer",
        "a mesh to its transfer functions",
        ".h5",
        (),
        files=(".ply", ".obj", ".stl", ".off", ".glb"),
        reads=("lights",),
    ),
    Verb(
        "to-sh",
        "clrelight.jobs.to_sh:to_sh",
        "a fit of a hemispherical basis to spherical harmonics",
        ".h5",
        ("fit", "encoded"),
    ),
    Verb(
        "preview",
        "clrelight.jobs.preview:preview",
        "a file of ours to a small picture",
        ".png",
        ("stack", "fit", "tiles", "encoded", "results", "light", "shrm"),
        endings=(".jpg",),
    ),
)
_OF_TILES = (
    Verb(
        "transfer-part",
        "clrelight.jobs.surface.transfer_chores:transfer_part",
        "functions of some vertices",
        ".npz",
        (),
    ),
    Verb(
        "transfer-hits",
        "clrelight.jobs.surface.transfer_chores:transfer_hits",
        "what rays of some vertices meet",
        ".npz",
        (),
    ),
    Verb("fit-rows", "clrelight.jobs.shards:fit_rows", "rows of a fit", ".h5", ("stack",), more=_of_methods),
    Verb("fit-join", "clrelight.jobs.shards:join_rows", "a fit of its rows", ".h5", ("stack",)),
    Verb("fit-part", "clrelight.jobs.fit_chores:fit_part", "rows of a fit and their errors", ".npz", ("stack",)),
    Verb("decode-rows", "clrelight.jobs.decoding_rows:decode_rows", "rows of a decoded fit", ".h5", ("encoded",)),
    Verb("decode-join", "clrelight.jobs.shards:join_rows", "a decoded fit of its rows", ".h5", ("encoded",)),
    Verb(
        "relight-some",
        "clrelight.jobs.relighting_chores:relight_some",
        "some pictures",
        ".npz",
        ("fit", "tiles", "encoded"),
    ),
    Verb("bench-part", "clrelight.batch.bench:bench_part", "rows of a grid", ".h5", ("stack",)),
    Verb("unpack-part", "clrelight.jobs.unpacking_chores:relight_part", "a part under lights", ".npz", ("encoded",)),
    Verb("unpack-light", "clrelight.jobs.unpacking_chores:write_light", "a photograph", "", ("encoded",)),
    Verb("pack-tile", "clrelight.jobs.packing_chores:code_tile", "streams of a tile", ".npz", ("stack",)),
    Verb("pack-try", "clrelight.jobs.packing_chores:try_pieces", "bytes of pieces", ".npz", ("stack",)),
    Verb("measure-windows", "clrelight.jobs.packing_chores:measure_coded", "errors of windows", ".npz", ("stack",)),
)
"""Parts of the jobs that are done in tiles."""
VERBS = {each.id: each for each in _EVERY}
"""Every job, in the order in which it is told of them."""
