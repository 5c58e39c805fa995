"""Every topic of hard cases, in the table's order."""

from tests.hard_cases import (
    cases_depth,
    cases_equivalence,
    cases_fit,
    cases_frames,
    cases_history,
    cases_place,
    cases_rays,
    cases_reprojection,
    cases_shading,
    cases_sparse,
)

TOPICS = tuple(
    module.TOPIC
    for module in (
        cases_history,
        cases_reprojection,
        cases_depth,
        cases_rays,
        cases_shading,
        cases_sparse,
        cases_fit,
        cases_equivalence,
        cases_place,
        cases_frames,
    )
)
