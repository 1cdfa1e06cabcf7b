"""What the record of an encoding usually says, for records to be short."""

USUAL = (
    b'"allocation":"map""amplitude":"basis":"bits":"block":"clamped":"clusters":"codec":"components":"entropy_bits":'
    b'"energy":1.0,"iterations":32,"lambda":"quality":"window":,"bytes":"reason":"false,"true,"cls""uls""ceb""wavelet"'
    b'"perceptual""srgb""solid-angle""spectrum-curve""basis":"hsh","spline""lam":0.00,"per":"stack",'
    b'"peak":1.0,"peak":65535.0,"step":null},"transfer":"srgb"'
    b'{"config":{"byte_budget":null,"metric":"radiance","rate":0.1,"step":null,"transfer":"linear"},"degree":1'
    b',"fit_config":{"azimuth":-0.,"edge":0.0,"heat":0.0,"holdout":{"by":"index","every":5,"lights":null},'
    b'"level":0.,"limit":25,"noise":0.00,"precision":"mixed","sampling":"hemisphere","share":1.0,'
    b'"slope":1.,"tilt":1.,"weights":"uniform"},"info":{"planes":1.0,"step":0.0},'
    b'"method":"spectrum","name":"","peak":255.0,"transfer":"linear"}'
)
"""What records are about: zlib's dictionary. It is part of the format (docs/files.md)."""
