"""Devices, compiled programs, errors and parts by name, for packages that build on dc2g_jax."""

from dc2g_jax._src.files.cache import keep_compiled_programs as keep_compiled_programs
from dc2g_jax._src.runtime.devices import (
    batched as batched,
    deal as deal,
    first_copy as first_copy,
    gather as gather,
    mesh_for_batch as mesh_for_batch,
    mesh_of as mesh_of,
    not_repeated as not_repeated,
    on_each as on_each,
    replicate as replicate,
    require_memory as require_memory,
    serve_paced as serve_paced,
)
from dc2g_jax._src.runtime.errors import (
    InputError as InputError,
    check_name as check_name,
    check_number as check_number,
    require_extra as require_extra,
    short as short,
)
from dc2g_jax._src.runtime.own_parts import own_part as own_part
from dc2g_jax._src.runtime.programs import jit as jit
