#!/bin/sh
# Simulate the plume, paint the styles, stylize the one with the other, and say where everything is.
#
#   sh examples/plume/demo.sh OUT_FOLDER [STYLE]     (run by `make demo`; STYLE: waves, mosaic, ...)
set -eu
here=$(dirname "$0")
out=${1:?"usage: demo.sh OUT_FOLDER [STYLE]"}
style=${2:-waves}
bin=.venv/bin

"$bin/python" "$here/simulate.py" "$out/source"
"$bin/python" "$here/../styles/paint.py" "$out/styles" --only strokes waves petals "$style"
# a shot, and one frame of it with the settings for delivery
"$bin/usdsmoke" stylize "$out/source/plume.usda" --style "$out/styles/$style.png" \
    --config "$here/config.yaml" -o "$out/look" --force
"$bin/usdsmoke" stylize "$out/source/plume.usda" --style "$out/styles/$style.png" \
    --config "$here/config.yaml" --preset final --frames 8 --seed 0 -o "$out/final" --force

cat <<END

The stylized plume is ready.

  look at it     $out/look/contact_sheet.png   (eight frames with the default preset)
                 $out/final/contact_sheet.png  (one frame with the preset final)
  open it        $out/look/plume_look.usda  (usdview, Blender, Houdini; camera /cameras/front)
  the source     $out/source/plume.usda
  the styles     $out/styles/

Next:
  $bin/usdsmoke validate $out/look/plume_look.usda
  $bin/usdsmoke inspect $out/source/plume.usda
  $bin/usdsmoke preview $out/look/plume_look.usda -o $out/preview.png --compare --width 200
  sh $here/demo.sh $out strokes    (another style)
  $bin/usdsmoke stylize YOUR_STAGE.usd --style YOUR_IMAGE.png -o YOUR_FOLDER
END
