/* The numbers and the sizes of lfo_kernel.c in this folder. */
#ifndef LFO_SETTINGS_H
#define LFO_SETTINGS_H

#define LFO_REAL {{ real.name }}
#define LFO_SQRT sqrt{{ real.suffix }}
#define LFO_FAMILIES {{ [integers.families, 1] | max }}
#define LFO_STATES {{ integers.n }}

#include "lfo_kernel.h"

#endif
