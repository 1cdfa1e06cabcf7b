"""HDF5 files of ours: all that a reader sees of one, and how other programs change them."""

from clrelight import store
from clrelight.store.seal import SEAL_ATTRIBUTE
from tests.surfaces import surface_content


def unseal(file):
    """Take away the checksums of a file of ours, as the refusal of a changed one says to."""
    held = bears_seal(file)
    if SEAL_ATTRIBUTE in held.attrs:
        del held.attrs[SEAL_ATTRIBUTE]
        file.pop("clrelight", None)  # which an encoding of one block has not


def bears_seal(file):
    """Return what of a file of ours has its seal: an encoding's payload, or the root."""
    return file["payload"] if SEAL_ATTRIBUTE in getattr(file.get("payload"), "attrs", ()) else file


def content(kind, path):
    """Return all that a reader can see of a file, comparable with ==."""
    match kind:
        case "stack":
            with store.open_stack(path) as s:
                arrays = (s.images_ihwc[...], s.directions_i3, s.weights_i, s.mask_hw)
                return (*(a.tobytes() for a in arrays), s.peak, s.transfer, s.name, s.images_ihwc.shape)
        case "fit" | "surface":
            f = store.read_fit(path)
            arrays = (f.coeffs_khwc, f.lambda_hwc, f.rank_hwc, f.directions_i3)
            return (*(a.tobytes() for a in arrays), f.method, f.degree, f.peak, f.transfer, f.name, str(f.config)) + (
                () if f.surface is None else surface_content(f.surface)
            )
        case "encoded":
            e, r = store.read_encoded(path)
            return (e.to_bytes(), str(e.config), str(e.info), r.directions_i3.tobytes(), str(r.config), r.name, r.peak)
        case "light":
            light = store.read_light(path)
            return (light.coeffs_kc.tobytes(), light.degree, light.source, light.axes, str(light.config))
        case "shrm":
            held = store.read_shrm(path)
            facts = (held.frame, held.degree, held.centre, held.source, held.axes, str(held.config))
            return (held.maps_khwc.tobytes(), held.maps_khwc.shape, *facts)
        case _:
            r = store.read_results(path)
            items = {**r.pictures, **r.profiles}
            return (r.table.tobytes(), *((k, v.tobytes()) for k, v in items.items()))
