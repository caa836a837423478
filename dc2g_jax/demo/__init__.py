"""The demo: watch planners step by step in the browser, on a map that you choose or draw."""

#: Its commands, see `dc2g_jax._src.runtime.plugins`.
COMMANDS = {
    "demo": ("dc2g_jax.demo.command", "watch planners step by step in the browser, on a map that you choose or draw")
}
