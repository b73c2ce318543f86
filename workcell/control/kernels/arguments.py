"""What each compiled function is handed: declared once, for the compiler and for the callers.

A function takes a table of numbers: its sizes, then the addresses of its arrays, in this order.
`f` is float64, `i` int64, `m` a C int, `b` true or false in one byte; all arrays are C-contiguous.
Whatever a function cannot do (a number that is not finite, a reading that means an error) it answers
with `answer[0] = REFUSED`; then the NumPy code is asked, which says what is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

REFUSED = -2
"""In `answer[0]`: left to the NumPy code."""
DONE = 0


@dataclass(frozen=True)
class Array:
    """An array argument."""

    name: str
    kind: str
    """`f`, `i`, `m` or `b`."""
    shape: tuple[str, ...]
    """Of names of sizes, or numbers."""


@dataclass(frozen=True)
class Signature:
    """The arguments of one function."""

    sizes: tuple[str, ...]
    arrays: tuple[Array, ...]


def _signature(sizes: str, arrays: str) -> Signature:
    """From lines of `name kind size size ...`."""
    rows = [line.split() for line in arrays.strip().splitlines()]
    return Signature(
        tuple(sizes.split()), tuple(Array(name, kind, tuple(shape)) for name, kind, *shape in rows)
    )


SIGNATURES: dict[str, Signature] = {
    "measure": _signature(
        "pairs joints geoms bodies sensors",
        """
        sensordata    f sensors
        geom_xpos     f geoms 3
        geom_xmat     f geoms 9
        cdof          f joints 6
        subtree_com   f bodies 3
        sensor_adr    i pairs
        geom          i pairs 2
        dof_root      i joints
        radius        f pairs 2
        half_length   f pairs 2
        sign          f pairs joints
        screws        f 6 joints
        distance      f pairs
        normal        f pairs 3
        witness_i     f pairs 3
        witness_j     f pairs 3
        surface_i     f pairs 3
        surface_j     f pairs 3
        jacobian      f pairs joints
        degenerate    b pairs
        answer        i 1
        """,
    ),
    "second_order": _signature(
        "pairs joints geoms bodies",
        """
        geom_xpos     f geoms 3
        geom_xmat     f geoms 9
        cdof          f joints 6
        cdof_dot      f joints 6
        subtree_com   f bodies 3
        qvel          f joints
        qacc          f joints
        body_parent   i bodies
        body_root     i bodies
        dof_body      i joints
        geom          i pairs 2
        body          i pairs 2
        radius        f pairs 2
        half_length   f pairs 2
        face          f pairs 2 3
        witness_i     f pairs 3
        witness_j     f pairs 3
        normal        f pairs 3
        degenerate    b pairs
        twist         f bodies 6
        change        f bodies 6
        accel         f pairs
        exact         b pairs
        parallel      b pairs
        answer        i 1
        """,
    ),
    "reciprocal_first_order": _signature(
        "pairs",
        """
        distance      f pairs
        rate          f pairs
        setting       f 1
        kappa         f pairs
        answer        i 1
        """,
    ),
    "reciprocal_second_order": _signature(
        "pairs",
        """
        distance      f pairs
        rate          f pairs
        accel         f pairs
        setting       f 1
        kappa         f pairs
        answer        i 1
        """,
    ),
    "smallest": _signature(
        "pairs",
        """
        kappa         f pairs
        ttc           f 1
        pair          i 1
        answer        i 1
        """,
    ),
    "average": _signature(
        "pairs kind",
        """
        distance      f pairs
        rate          f pairs
        value         f 1
        answer        i 1
        """,
    ),
    "objective": _signature(
        "pairs joints kind",
        """
        distance      f pairs
        rate          f pairs
        rows          f pairs joints
        other         f pairs
        hessian       f joints joints
        linear        f joints
        answer        i 1
        """,
    ),
    "aim": _signature(
        "joints bodies sites dofs",
        """
        site_xpos     f sites 3
        site_xmat     f sites 9
        cdof          f joints 6
        subtree_com   f bodies 3
        site          i 1
        dof           i dofs
        dof_root      i dofs
        moves         b dofs
        position      f 3
        wxyz          f 4
        velocity      f 3
        turn          f 3
        settings      f 4
        free          i 1
        rows          f 6 dofs
        rates         f 6
        gram          f 6 6
        solved        f 2 6
        whole         f dofs
        path          f dofs
        error         f 2
        answer        i 1
        """,
    ),
    "with_room_to_stops": _signature(
        "joints",
        """
        q             f joints
        lower         f joints
        upper         f joints
        linear        f joints
        setting       f 3
        pushed        f joints
        any           i 1
        answer        i 1
        """,
    ),
    "pairwise_factor": _signature(
        "pairs",
        """
        distance      f pairs
        own           f pairs
        other         f pairs
        setting       f 2
        found         f 3
        which         i 2
        answer        i 1
        """,
    ),
    "acceleration_interval": _signature(
        "dofs",
        """
        previous      f dofs
        wanted        f dofs
        limit         f dofs
        setting       f 1
        found         f 2
        answer        i 1
        """,
    ),
    "settle": _signature(
        "dofs",
        """
        velocity      f dofs
        low           f dofs
        high          f dofs
        setting       f 1
        settled       f dofs
        answer        i 1
        """,
    ),
    "followed": _signature(
        "dofs coordinates",
        """
        qpos          f coordinates
        address       i dofs
        lower_rad     f dofs
        upper_rad     f dofs
        speed         f dofs
        acceleration  f dofs
        previous      f dofs
        wanted        f dofs
        setting       f 1
        within        f dofs
        answer        i 1
        """,
    ),
    "rates": _signature(
        "pairs joints arms order",
        """
        jacobian      f pairs joints
        distance      f pairs
        velocity      f joints
        accel         f pairs
        silent        b pairs
        owner         i joints
        rate          f pairs
        ttc           f 1
        which         i 3
        part          f arms
        answer        i 1
        """,
    ),
    "surroundings": _signature(
        "pairs averaged kind",
        """
        distance      f pairs
        rate          f pairs
        criterion     i averaged
        value         f 2
        answer        i 1
        """,
    ),
    "program": _signature(
        "pairs joints chosen averaged dofs coordinates room constraints",
        """
        jacobian      f pairs joints
        distance      f pairs
        rate          f pairs
        ways          f 3 joints
        index         i chosen
        criterion     i averaged
        dof           i dofs
        task          f dofs
        push          f dofs
        qvel          f joints
        counted_on    f 3 joints
        near_distance f averaged
        near_rate     f averaged
        near_rows     f averaged dofs
        near_other    f averaged
        q             f dofs
        rule          f 4
        stops         f 3
        pushed        f dofs
        any           i 1
        count         i 1
        qpos          f coordinates
        address       i dofs
        lower_rad     f dofs
        upper_rad     f dofs
        speed         f dofs
        acceleration  f dofs
        previous      f dofs
        settings      f 2
        counts        i 2
        hessian       f dofs dofs
        linear        f dofs
        tool_rows     f 6 dofs
        tool_rates    f 6
        rows          f room dofs
        bounds        f room
        low           f dofs
        high          f dofs
        H             f dofs dofs
        c             f dofs
        lower         f constraints
        upper         f constraints
        sense         m constraints
        choice        i 4
        other         f pairs
        answer        i 1
        """,
    ),
    "allow": _signature(
        "pairs joints owned dofs",
        """
        jacobian      f pairs joints
        distance      f pairs
        other         f pairs
        index         i owned
        meeting       b owned
        standing      b owned
        dof           i dofs
        wanted        f dofs
        previous      f dofs
        limit         f dofs
        rule          f 6
        period        f 1
        factor_setting f 2
        counted       f owned
        reached       b owned
        own           f owned
        rest          f owned
        found         f 3
        which         i 2
        reach         f 2
        told          i 2
        answer        i 1
        """,
    ),
    "keeps": _signature(
        "pairs joints owned dofs",
        """
        jacobian      f pairs joints
        distance      f pairs
        other         f pairs
        index         i owned
        meeting       b owned
        dof           i dofs
        command       f dofs
        rule          f 5
        kept_other    f owned
        answer        i 1
        """,
    ),
}
"""By the name of the function in `source`."""
