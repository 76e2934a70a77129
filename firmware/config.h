/* What a lab may change: limits and sensors. Each value may also be given to make:
 * make CONFIG="-DFRONT_MV_PER_A=185 -DMEAN_LIMIT_MA=3300" */
#ifndef CONFIG_H
#define CONFIG_H

#define FIRMWARE_NAME "sma-uno"
#define PROTOCOL_VERSION 2
#ifndef BUILD_HASH
#define BUILD_HASH "ide" /* the Makefile gives a hash of the sources */
#endif

#ifndef BAUD_RATE
#define BAUD_RATE 500000UL /* exact at 16 MHz; 115200 is 2.1 % off */
#endif
#define CHANNELS 4         /* front_1, front_2, back_1, back_2 */
#define BOARDS 2           /* front, back: two channels and one current sensor each */

/* Limits. The host reads them in the handshake and may set lower ones for its rig (command C). */
#ifndef MAX_COMMAND_MV
#define MAX_COMMAND_MV 10000
#endif
#ifndef COMMAND_TIMEOUT_MS
#define COMMAND_TIMEOUT_MS 200
#endif
#ifndef DUTY_LIMIT_Q16
#define DUTY_LIMIT_Q16 58982 /* 0.90 */
#endif
#ifndef MEAN_LIMIT_MA
#define MEAN_LIMIT_MA 6500 /* two wires of 2.7 ohm at 10 V from 12 V: 6.2 A */
#endif
#ifndef PEAK_LIMIT_MA
#define PEAK_LIMIT_MA 12000 /* both wires switched on at 12 V: 8.9 A */
#endif
#ifndef LEAST_MOHM
#define LEAST_MOHM 1000 /* lowest resistance of any wire: a larger current is a short circuit */
#endif
#ifndef USUAL_MOHM
#define USUAL_MOHM 1890 /* used until the host sets that of its wires: 0.7 of 2.7 ohm */
#endif
#ifndef HOT_MV
#define HOT_MV 8000 /* rms voltage of a wire over HOT_MS */
#endif
#ifndef HOT_MS
#define HOT_MS 2000
#endif
#ifndef EXTRA_MA
#define EXTRA_MA 80 /* of a board, above what its outputs explain: noise of the mean, zero removed */
#endif
#ifndef OFF_LIMIT_MA
#define OFF_LIMIT_MA 500 /* of a board with its outputs off: an ACS712 may be 0.4 A off */
#endif
#ifndef RELAY_MS
#define RELAY_MS 30 /* from the coil's current until the contact has stopped bouncing */
#endif
#ifndef ON_TIME_DUTY_Q16
#define ON_TIME_DUTY_Q16 6554 /* 0.10 counts as on: 3.8 V from 12 V */
#endif
#ifndef ON_TIME_LIMIT_S
#define ON_TIME_LIMIT_S 900
#endif
#ifndef SUPPLY_MIN_MV
#define SUPPLY_MIN_MV 6000
#endif
#ifndef SUPPLY_MAX_MV
#define SUPPLY_MAX_MV 15000
#endif

/* Sensors, nominal; the host corrects them with its calibration. */
#ifndef FRONT_MV_PER_A
#define FRONT_MV_PER_A 100 /* ACS712-20A 100, ACS712-05B and ACS714-05B 185, -30A 66 */
#endif
#ifndef BACK_MV_PER_A
#define BACK_MV_PER_A 100
#endif
#ifndef SUPPLY_DIVIDER
#define SUPPLY_DIVIDER 4 /* 3 kohm over 1 kohm: 20 V full scale */
#endif

#define REFERENCE_MV 5000 /* AVcc, nominal; 4.75 to 5.1 V from USB, measured against BANDGAP_MV */
#define BANDGAP_MV 1100   /* of the chip, nominal; 1.0 to 1.2 V: calibrate the supply's reading */
#define ADC_STEPS 1024UL
#define ADC_MIDDLE 512U /* an ACS71x at 0 A gives half its supply, which is the reference */

#endif
