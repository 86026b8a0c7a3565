(define (problem round)
  (:domain patrol)
  (:objects r2d2 - robot hall kitchen office - room)
  (:init
    (robot_at r2d2 hall) (battery_full r2d2) (charging_point_at hall)
    (connected hall kitchen) (connected kitchen hall) (connected hall office) (connected office hall)
  )
  (:goal (and (patrolled kitchen) (patrolled office)))
)
