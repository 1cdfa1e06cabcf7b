"""CDF 9/7 in float64 by plain convolution with the filters' taps: an independent check of the lifting."""

import numpy as np

# ISO/IEC 15444-1 table F.4 gives the lifting; these are the filters' taps as published by Cohen, Daubechies and
# Feauveau 1992 (analysis low-pass with gain 1 at frequency 0, high-pass with gain 1 at the Nyquist frequency).
LOW = np.array(
    [0.6029490182363579, 0.2668641184428723, -0.07822326652898785, -0.01686411844287495, 0.02674875741080976]
)
HIGH = np.array([0.5575435262284970, -0.2956358815571280, -0.02877176311424978, 0.04563588155712474])


def analyse_signal(signal):
    """Split the first axis; low samples in front of the high ones, each filter scaled to be near orthonormal."""
    signal = np.asarray(signal, dtype=np.float64)
    size = len(signal)
    if size == 1:
        return signal.copy()
    low = [_filter(signal, centre, LOW) for centre in range(0, size, 2)]
    high = [_filter(signal, centre, HIGH) for centre in range(1, size, 2)]
    return np.sqrt(2.0) * np.stack(low + high)


def _filter(signal, centre, taps):
    size = len(signal)
    total = taps[0] * signal[centre]
    for distance in range(1, len(taps)):
        for position in (centre - distance, centre + distance):
            position = abs(position) % (2 * (size - 1))
            total = total + taps[distance] * signal[min(position, 2 * (size - 1) - position)]
    return total


def analyse_plane(plane, levels):
    """Split rows and columns `levels` times, the low part again each time."""
    bands = np.array(plane, dtype=np.float64)
    height, width = bands.shape
    for _ in range(levels):
        part = analyse_signal(bands[:height, :width])
        bands[:height, :width] = analyse_signal(part.T).T
        height, width = (height + 1) // 2, (width + 1) // 2
    return bands
