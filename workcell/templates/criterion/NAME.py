"""`NAME`: a null-space criterion of your own. Change the weights, then compare it with the others.

    workcell run handover --plugin NAME.py --set control.criterion=NAME
    workcell sweep handover --plugin NAME.py --runs 10 --compare control.criterion=NAME,artc,armd
"""

import numpy as np


def criterion(distance_m, rate_m_s, rows):
    """Away from pairs that close, the more the sooner they would collide.

    Args:
        distance_m: (P,) of the pairs that the arm is averaged over.
        rate_m_s: (P,) their rates without the arm's own self-motion; negative closes.
        rows: (P, n) of G, the distances' derivatives by the arm's joints.

    Returns:
        H (n, n) and c (n,): the null space descends 1/2 q' H q' + c q'.
    """
    n = rows.shape[1]
    distance = np.maximum(distance_m, 1e-3)
    weight = np.maximum(0.0, -rate_m_s) / distance**2
    return np.zeros((n, n)), -(weight @ rows) / max(1, len(rows))


CRITERIA = {"NAME": criterion}
