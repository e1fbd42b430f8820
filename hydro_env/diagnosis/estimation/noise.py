"""How noisy a signal is, and how many independent samples a residual is worth."""

import numpy as np

#: Length of the windows, s, about as long as the memory of a shaft with a leaky motor.
WINDOW_S = 0.15

#: A window counts if this share of its rows is there.
FULL = 0.75


def noise_floor(residual: np.ndarray, inside: np.ndarray, period: float, window_s: float = WINDOW_S) -> float:
    """Standard deviation of what no smooth curve explains: a low quantile over short windows about their own parabola.

    `residual` (T,) is measured minus simulated, which is smoother than the signal itself; where the model is poor the
    quantile over windows keeps edges of its error out, and noise that is coloured up to the window's length stays in.
    Falls back on second differences where there are too few rows for windows. NaN if no sample is there.
    """
    width = max(8, round(window_s / period))
    good = inside & np.isfinite(residual)
    t = np.linspace(-1.0, 1.0, width)
    basis, _ = np.linalg.qr(np.column_stack([np.ones(width), t, t * t]))
    found = []
    for start in range(0, residual.size - width + 1, width):
        here = good[start : start + width]
        if here.mean() >= FULL:
            # Rows that are missing are left out of the parabola, too.
            piece = residual[start : start + width][here]
            own = basis if here.all() else np.linalg.qr(basis[here])[0]
            rest = piece - own @ (own.T @ piece)
            found.append(rest @ rest / (piece.size - 3))
    # Windows without any noise are standstill or a computed signal; they say nothing of the rest.
    found = [value for value in found if value > 1e-9 * max(found)]
    if len(found) >= 5:
        # The low quantile of a mean of squares of white noise, by its normal approximation.
        share = 1.0 - 0.385 * np.sqrt(2.0 / (width - 3))
        return float(np.sqrt(np.quantile(found, 0.35) / share))
    piece = residual[good]
    if piece.size < 4:
        return float("nan")
    return float(np.std(np.diff(piece, 2)) / np.sqrt(6.0))


def effective_samples(residual: np.ndarray) -> float:
    """Number of independent samples that a residual (T,) is worth: T over its integrated autocorrelation time.

    Geyer's initial positive sequence on the autocorrelation by FFT.
    """
    n = residual.size
    x = residual - residual.mean()
    power = float(x @ x)
    if n < 8 or power <= 0.0:
        return float(max(n, 1))
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(x, size)
    rho = np.fft.irfft(spectrum * spectrum.conj(), size)[:n] / power
    pairs = rho[0 : n - n % 2 : 2] + rho[1:n:2]
    stop = np.flatnonzero(pairs <= 0.0)
    tau = 2.0 * float(pairs[: stop[0] if stop.size else pairs.size].sum()) - 1.0
    return float(np.clip(n / max(tau, 1.0), 1.0, n))
