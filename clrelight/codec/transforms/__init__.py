"""What maps become before they are coded: wavelets, principal axes, code values, texel blocks, vectors."""
