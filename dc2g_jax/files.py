"""Pictures, tables and documents, read strictly and written atomically."""

from dc2g_jax._src.files.atomic import replacing as replacing
from dc2g_jax._src.files.class_images import (
    PALETTE_FILE as PALETTE_FILE,
    Palette as Palette,
    read_class_image as read_class_image,
    read_palette as read_palette,
    write_class_image as write_class_image,
    write_palette as write_palette,
)
from dc2g_jax._src.files.digests import arrays_sha256 as arrays_sha256, tree_sha256 as tree_sha256
from dc2g_jax._src.files.png import MOST_PIXELS as MOST_PIXELS, read_png as read_png, write_png as write_png
from dc2g_jax._src.files.reading import (
    TEXT as TEXT,
    check_file as check_file,
    finite_number as finite_number,
    opened as opened,
    parse_json as parse_json,
    read_bytes as read_bytes,
    read_lines as read_lines,
    read_object as read_object,
    read_text as read_text,
)
from dc2g_jax._src.files.resources import resource as resource
from dc2g_jax._src.files.tables import text_table as text_table, write_table as write_table
