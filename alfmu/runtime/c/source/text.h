/* Texts are in message.h. */

#include "message.h"
