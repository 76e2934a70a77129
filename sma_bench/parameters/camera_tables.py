"""Parameters of the infrared camera's node, and of the synthetic camera that stands in for it."""

from sma_bench.parameters.parameter import MANAGED, Parameter, fixed

# What both have to agree on.
_SCENE = fixed(
    Parameter(
        "image_width", "px", 382, "Columns of thermal_image.", "Optris Xi 400", 32, 4096,
        kind="integer",
    ),
    Parameter(
        "image_height", "px", 288, "Rows of thermal_image.", "Optris Xi 400", 32, 4096,
        kind="integer",
    ),
    Parameter(
        "pixel_size", "m", 0.4e-3, "Size of a pixel at the wire: 17 um times distance over focal "
        "length.",
        "assumed: Xi 400 with the lens of 12.7 mm (29 degrees) at 0.3 m", 1e-6, 0.1,
    ),
    Parameter(
        "emissivity", "1", 0.95, "Emissivity of the wires in the camera's band.",
        "assumed: wire painted matt black; bare wire reads far too low with it, see docs/camera.md",
        0.05, 1.0,
    ),
    Parameter(
        "reflected_temperature", "K", 0.0,
        "Temperature of the surroundings that the wires mirror; 0 for "
        "environment.ambient_temperature.",
        "choice", 0.0, 1000.0,
    ),
)

IR_CAMERA = fixed(
    *_SCENE,
    MANAGED,
    Parameter(
        "regions", "", ("",),
        "One a channel: 'X Y WIDTH HEIGHT', upper left corner and size in pixels of the part of "
        "the picture that its wire stays in, then x or y if the wire does not run along the longer "
        "side; empty, with one channel, for the whole picture.",
        "choice", kind="strings",
    ),
    Parameter(
        "statistic", "", "median",
        "Over the wire's length: mean, median, or hottest (a sixth of a dozen lines; reads high "
        "by twice its noise).",
        "choice: a median passes over clamps and hot spots", kind="string",
    ),
    Parameter(
        "correct_fill", "", True,
        "Correct for a wire that does not fill its pixels; false takes the wire's middle pixel, "
        "for wires of five pixels or more.",
        "choice", kind="bool",
    ),
    Parameter(
        "pixel_size_std", "m", 8e-6, "Standard deviation of pixel_size.",
        "assumed: 2 %, a scale of 50 mm in the picture read to a millimetre", 0.0, 0.1,
    ),
    Parameter(
        "emissivity_std", "1", 0.02, "Standard deviation of emissivity.", "assumed", 0.0, 1.0,
    ),
    Parameter(
        "reflected_temperature_std", "K", 2.0, "Standard deviation of reflected_temperature.",
        "assumed", 0.0, 500.0,
    ),
    Parameter(
        "camera_accuracy", "K", 1.2,
        "Standard deviation of the camera's calibration, common to all pixels.",
        "Optris Xi 400: 2 K or 2 %, as the limits of a rectangle", 0.0, 100.0,
    ),
    Parameter(
        "camera_lowest", "K", 253.15, "Lower end of the camera's measuring range.",
        "Optris Xi 400: -20 degC; its 0 to 250 degC range shows colder as that", 173.15, 2000.0,
    ),
    Parameter(
        "camera_highest", "K", 523.15, "Upper end of the camera's measuring range.",
        "Optris Xi 400: 250 degC", 273.15, 3000.0,
    ),
    Parameter(
        "least_visible", "1", 0.5,
        "Share of its region's length in which a wire must be seen to be read.", "choice",
        0.1, 1.0,
    ),
    Parameter(
        "read_cold_wires", "", False,
        "Read wires that are not warmer than their background too: a dark line as a wire, and "
        "nothing to be seen as the background's temperature, with half of what could just be seen "
        "as deviation. Needs <channel>/power to notice a heated wire that is not there.",
        "choice: nothing is read that is not seen", kind="bool",
    ),
    Parameter(
        "stale_limit", "s", 0.25, "Age at which a frame is held back, and silence an error.",
        "choice: twenty frames", 0.01, 10.0,
    ),
    Parameter(
        "shutter_spread", "K", 1.0,
        "A frame whose warmest and coldest pixels differ by less shows the camera's shutter; 0 "
        "for never.",
        "assumed: noise of 80 mK spreads over 0.7 K", 0.0, 100.0,
    ),
    Parameter(
        "shutter_settle", "s", 0.1, "Time after the shutter in which frames are held back.",
        "assumed", 0.0, 10.0,
    ),
)

SYNTHETIC_CAMERA = (
    *_SCENE,
    MANAGED,
    *fixed(
        Parameter(
            "rate", "Hz", 80.0, "Rate of thermal_image.", "Optris Xi 400, 80 Hz", 1.0, 200.0,
        ),
        Parameter(
            "wires", "", ("",),
            "One a channel: 'X0 Y0 X1 Y1' in pixels, from the clamped end to the one that moves; "
            "empty for wires side by side across the whole picture.",
            "choice", kind="strings",
        ),
        Parameter(
            "background", "K", 0.0,
            "Apparent temperature behind the wires; 0 for environment.ambient_temperature.",
            "choice", 0.0, 1000.0,
        ),
        Parameter(
            "unevenness", "K", 3.0, "How much warmer the background's lower right corner is.",
            "assumed: a room is never of one temperature", 0.0, 100.0,
        ),
        Parameter(
            "blur", "px", 0.7, "Standard deviation of the lens's blur.",
            "assumed: 90 % of an edge within three pixels", 0.0, 5.0,
        ),
        Parameter(
            "noise", "K", 0.08, "Standard deviation of every pixel.", "Optris Xi 400: 80 mK",
            0.0, 10.0,
        ),
        Parameter(
            "sway", "px", 3.0, "Amplitude of a slow sideways movement of the wires' free ends.",
            "choice: a wire in air is never still", 0.0, 100.0,
        ),
        Parameter(
            "seed", "", 1, "Seed of the noise.", "choice", 0, 2**31 - 1, kind="integer",
        ),
    ),
    Parameter(
        "fault", "", "none",
        "What goes wrong: none, frozen (the last picture with new stamps), shutter (a uniform "
        "surface), silent (no pictures), moved (the wires are out of the picture).",
        "for tests", kind="string",
    ),
)
