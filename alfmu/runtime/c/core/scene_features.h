/* Features that a scene may need. A library for one scene leaves out the files of those that it does not need
   (FEATURES in alfmu/fmi/native.py), and their headers declare functions that do nothing in place of them. */

#ifndef ALFMU_SCENE_FEATURES_H
#define ALFMU_SCENE_FEATURES_H

#ifndef HAS_FRICTION
#define HAS_FRICTION 1
#endif
#ifndef HAS_MOVING_INPUTS
#define HAS_MOVING_INPUTS 1
#endif
#ifndef HAS_LIMITS
#define HAS_LIMITS 1
#endif
#ifndef HAS_SWITCHES
#define HAS_SWITCHES 1
#endif
#ifndef HAS_BREAKS
#define HAS_BREAKS 1
#endif
#ifndef HAS_LAWS
#define HAS_LAWS 1
#endif
#ifndef HAS_PEAKS
#define HAS_PEAKS 1
#endif
#ifndef HAS_ERROR_CONTROL
#define HAS_ERROR_CONTROL 1
#endif
#ifndef HAS_MODEL_EXCHANGE
#define HAS_MODEL_EXCHANGE 1
#endif
#ifndef HAS_INTERFACE_JACOBIAN
#define HAS_INTERFACE_JACOBIAN 1
#endif
#ifndef HAS_DERIVATIVES
#define HAS_DERIVATIVES 1
#endif

#endif
