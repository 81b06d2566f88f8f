"""Whether what drives a wing is steady noise, as the likelihood of a stationary response takes it to be.

Blows are not, nor is a force that begins or ends within the record. What the past of the record cannot predict is the
force's share of each sample: of steady Gaussian noise its kurtosis (Mardia 1970) is that of a normal distribution.
"""

import numpy as np

from fsw.modal.autoregression import Predicted

# Largest kurtosis, over a normal distribution's. Of 400 samples steady noise has 1 +- 0.03; blows that are as many as
# those of a panel loose between its stops have 1.8 and more, a force that ends halfway 6 and more.
_LARGEST_KURTOSIS = 1.3


def is_steady(predicted: Predicted | None) -> bool:
    """Whether the force behind a stationary response is steady noise; False where no model could predict it."""
    if predicted is None:
        return False
    width = predicted.errors.shape[1]
    return float(np.mean(predicted.squares() ** 2)) < _LARGEST_KURTOSIS * width * (width + 2.0)
